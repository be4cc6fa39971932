//! Eigenvalues of many matrices: convert, compute without the GIL, map the error.

use numpy::{IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyArithmeticError, PyValueError};
use pyo3::prelude::*;

use crate::statespace::not_contiguous;

/// Adds this file's function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(eigenvalues, module)?)
}

/// Real and imaginary parts (count, n, 2) of the eigenvalues of matrices (count, n, n).
#[pyfunction]
fn eigenvalues<'py>(
    py: Python<'py>,
    matrices: PyReadonlyArray3<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let &[count, n, columns] = matrices.shape() else {
        unreachable!("three dimensions")
    };
    if n != columns || n == 0 {
        return Err(PyValueError::new_err(format!(
            "expected square matrices, got {n} x {columns}"
        )));
    }
    let matrices = matrices
        .as_slice()
        .map_err(|_| not_contiguous("matrices"))?;
    let values = py.detach(|| strainwave_numerics::eigenvalues::eigenvalues(matrices, n));
    let values = values.ok_or_else(|| {
        PyArithmeticError::new_err("eigenvalues do not converge; is an entry not finite?")
    })?;
    values
        .into_flattened()
        .into_pyarray(py)
        .reshape([count, n, 2])
}
