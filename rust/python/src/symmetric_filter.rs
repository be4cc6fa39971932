//! Filters at selected samples: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::symmetric_filter::{Samples, filter};

use crate::statespace::not_contiguous;

/// Adds this file's function to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(symmetric_filter, module)?)
}

/// Samples (count, columns) of a signal (n, columns) after a filter with a symmetric response.
#[pyfunction]
fn symmetric_filter<'py>(
    py: Python<'py>,
    signal: PyReadonlyArray2<'py, f64>,
    response: PyReadonlyArray1<'py, f64>,
    first: usize,
    step: usize,
    count: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (length, columns) = (signal.shape()[0], signal.shape()[1]);
    let samples = Samples { first, step, count };
    let is_short = response.len() == 0 || response.len() > length;
    if columns == 0 || step == 0 || is_short || !samples.fit(length) {
        return Err(PyValueError::new_err(format!(
            "expected a response of at most {length} samples and {samples:?} within as many, got a response of {}",
            response.len()
        )));
    }
    let signal = signal.as_slice().map_err(|_| not_contiguous("signal"))?;
    let response = response
        .as_slice()
        .map_err(|_| not_contiguous("response"))?;
    let filtered = py.detach(|| filter(signal, columns, response, samples));
    filtered.into_pyarray(py).reshape([count, columns])
}
