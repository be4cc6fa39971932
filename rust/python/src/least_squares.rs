//! Least squares with windows of unknowns: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::elimination::{self, Windows};

use crate::statespace::not_contiguous;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(eliminate, module)?)?;
    module.add_function(wrap_pyfunction!(residual_products_without_blocks, module)?)
}

/// Eliminates unknowns with unit prior variance from right-hand sides: solution, residuals and
/// leverages.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn eliminate<'py>(
    py: Python<'py>,
    first: PyReadonlyArray1<'py, i64>,
    entries: PyReadonlyArray2<'py, f64>,
    unknowns: usize,
    right: PyReadonlyArray2<'py, f64>,
    leverage: bool,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
)> {
    let first = starts(&first)?;
    let z = windows(&first, &entries, unknowns)?;
    let (rows, sides) = checked_right(&first, &right)?;
    let right = right.as_slice().map_err(|_| not_contiguous("right"))?;
    let result = py.detach(|| elimination::eliminate(z, right, sides, leverage));
    let elimination = result.ok_or_else(|| PyValueError::new_err("expected finite equations"))?;
    Ok((
        elimination
            .solution
            .into_pyarray(py)
            .reshape([unknowns, sides])?,
        elimination
            .residuals
            .into_pyarray(py)
            .reshape([rows, sides])?,
        elimination.leverage.into_pyarray(py),
    ))
}

/// Products of the residuals after elimination, without each block of rows.
#[pyfunction]
fn residual_products_without_blocks<'py>(
    py: Python<'py>,
    first: PyReadonlyArray1<'py, i64>,
    entries: PyReadonlyArray2<'py, f64>,
    unknowns: usize,
    right: PyReadonlyArray2<'py, f64>,
    stops: Vec<usize>,
) -> PyResult<Vec<Bound<'py, PyArray2<f64>>>> {
    let first = starts(&first)?;
    let z = windows(&first, &entries, unknowns)?;
    let (rows, sides) = checked_right(&first, &right)?;
    if !stops.is_sorted() || stops.last().is_some_and(|last| *last > rows) {
        return Err(PyValueError::new_err(format!(
            "expected increasing stops within {rows} rows, got {stops:?}"
        )));
    }
    let right = right.as_slice().map_err(|_| not_contiguous("right"))?;
    let result =
        py.detach(|| elimination::residual_products_without_blocks(z, right, sides, &stops));
    let products = result.ok_or_else(|| PyValueError::new_err("expected finite equations"))?;
    let square = |block: Vec<f64>| block.into_pyarray(py).reshape([sides; 2]);
    products.into_iter().map(square).collect()
}

fn starts(first: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let negative = |_| PyValueError::new_err("expected windows that begin at an unknown");
    let first = first.as_slice().map_err(|_| not_contiguous("first"))?;
    first
        .iter()
        .map(|&at| usize::try_from(at).map_err(negative))
        .collect()
}

fn windows<'a>(
    first: &'a [usize],
    entries: &'a PyReadonlyArray2<'_, f64>,
    unknowns: usize,
) -> PyResult<Windows<'a>> {
    let width = entries.shape()[1];
    let entries = entries.as_slice().map_err(|_| not_contiguous("entries"))?;
    let windows = Windows {
        first,
        entries,
        width,
        unknowns,
    };
    if unknowns == 0 || !windows.fit() {
        return Err(PyValueError::new_err(format!(
            "expected {} windows within {unknowns} unknowns",
            first.len()
        )));
    }
    Ok(windows)
}

/// Numbers of rows and right-hand sides.
fn checked_right(first: &[usize], right: &PyReadonlyArray2<'_, f64>) -> PyResult<(usize, usize)> {
    let (rows, sides) = (right.shape()[0], right.shape()[1]);
    if rows != first.len() || sides == 0 {
        return Err(PyValueError::new_err(format!(
            "expected {} rows of right-hand sides, got {:?}",
            first.len(),
            right.shape()
        )));
    }
    Ok((rows, sides))
}
