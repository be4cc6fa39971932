//! Control loops and their margins: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::margins::{Margins, margins};

use crate::statespace::not_contiguous;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(open_loops, module)?)?;
    module.add_function(wrap_pyfunction!(loop_margins, module)?)
}

/// Loops (n_joints, n_plants, 2 n_omega) of responses (n_plants, n_pairs, 2 n_omega).
#[pyfunction]
fn open_loops<'py>(
    py: Python<'py>,
    responses: PyReadonlyArray3<'py, f64>,
    roots: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let (&[n_plants, n_pairs, width], &[n, columns]) = (responses.shape(), roots.shape()) else {
        unreachable!("three and two dimensions")
    };
    if width != columns || !width.is_multiple_of(2) || n_pairs != n * (n + 1) / 2 || width * n == 0
    {
        return Err(PyValueError::new_err(format!(
            "expected {width} numbers for all pairs of {n} joints, got {columns} for {n_pairs}"
        )));
    }
    let responses = responses
        .as_slice()
        .map_err(|_| not_contiguous("responses"))?;
    let roots = roots.as_slice().map_err(|_| not_contiguous("roots"))?;
    let loops = py.detach(|| strainwave_numerics::open_loops::open_loops(responses, roots, n));
    loops.into_pyarray(py).reshape([n, n_plants, width])
}

/// Numbers of margins, and encirclements.
type MarginArrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>);

/// Margins (n_plants, 7) of loops (n_plants, 2 n_omega) at frequencies [Hz], and their encirclements.
#[pyfunction]
fn loop_margins<'py>(
    py: Python<'py>,
    loops: PyReadonlyArray2<'py, f64>,
    hz: Vec<f64>,
) -> PyResult<MarginArrays<'py>> {
    let width = loops.shape()[1];
    if width != 2 * hz.len() || width == 0 {
        return Err(PyValueError::new_err(format!(
            "expected loops at {} frequencies, got {width} numbers",
            hz.len()
        )));
    }
    let loops = loops.as_slice().map_err(|_| not_contiguous("loops"))?;
    let responses = loops.as_chunks().0.chunks(hz.len());
    let each: Vec<Margins> =
        py.detach(|| responses.map(|response| margins(response, &hz)).collect());
    let rows = each.iter().flat_map(|one| {
        [
            one.gain_db,
            one.gain_hz,
            one.phase_deg,
            one.phase_hz,
            one.modulus,
            one.modulus_hz,
            one.bandwidth_hz,
        ]
    });
    Ok((
        PyArray1::from_iter(py, rows).reshape([each.len(), 7])?,
        PyArray1::from_iter(py, each.iter().map(|one| one.encirclements)),
    ))
}
