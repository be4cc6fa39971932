//! Triangular factors of tables: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::triangular::{self, Columns, WeightedRows};

use crate::statespace::not_contiguous;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(triangular_factor, module)?)?;
    module.add_function(wrap_pyfunction!(weighted_factor, module)?)
}

/// Triangular factor (n, n) of a table (n_rows, n).
#[pyfunction]
fn triangular_factor<'py>(
    py: Python<'py>,
    table: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let n = table.shape()[1];
    let table = table.as_slice().map_err(|_| not_contiguous("table"))?;
    let factor = py.detach(|| triangular::factor(table, n));
    factor.into_pyarray(py).reshape([n; 2])
}

/// Triangular factor of [scale columns, residual] without the constants of biased channels.
#[pyfunction]
fn weighted_factor<'py>(
    py: Python<'py>,
    columns: Vec<PyReadonlyArray3<'py, f64>>,
    scale: PyReadonlyArray2<'py, f64>,
    residual: PyReadonlyArray2<'py, f64>,
    biased: Vec<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let &[samples, channels] = scale.shape() else {
        unreachable!("two dimensions")
    };
    let shapes = columns.iter().map(|part| ("columns", part.shape()));
    for (name, shape) in shapes.chain([("residual", residual.shape())]) {
        if shape[..2] != [samples, channels] {
            return Err(PyValueError::new_err(format!(
                "{name}: expected {samples} x {channels} rows, got {} x {}",
                shape[0], shape[1]
            )));
        }
    }
    if let Some(channel) = biased.iter().find(|channel| **channel >= channels) {
        return Err(PyValueError::new_err(format!(
            "biased: expected numbers below {channels}, got {channel}"
        )));
    }
    let columns = columns
        .iter()
        .map(|part| {
            Ok(Columns {
                values: part.as_slice().map_err(|_| not_contiguous("columns"))?,
                unknowns: part.shape()[2],
            })
        })
        .collect::<PyResult<Vec<_>>>()?;
    let rows = WeightedRows {
        columns: &columns,
        scale: scale.as_slice().map_err(|_| not_contiguous("scale"))?,
        residual: residual
            .as_slice()
            .map_err(|_| not_contiguous("residual"))?,
        channels,
    };
    let factor = py.detach(|| rows.factor(&biased));
    factor.into_pyarray(py).reshape([rows.unknowns() + 1; 2])
}
