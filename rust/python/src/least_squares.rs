//! Least squares with windows of unknowns: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::elimination::{self, Windows};
use strainwave_numerics::reduction::{self, Part, Widths};

use crate::statespace::not_contiguous;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(reduce, module)?)?;
    module.add_function(wrap_pyfunction!(residual_products_without_blocks, module)?)
}

/// Rows, regressors and number of local unknowns.
type LocalPart<'py> = (
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray2<'py, f64>,
    usize,
);

/// Weighted equations without their local unknowns: norms of the parameters' columns, rows,
/// regression on the local unknowns, leverages, triangular factor.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn reduce<'py>(
    py: Python<'py>,
    table: PyReadonlyArray2<'py, f64>,
    root: PyReadonlyArray1<'py, f64>,
    n_common: usize,
    n_parameters: usize,
    parts: Vec<LocalPart<'py>>,
    stds: PyReadonlyArray1<'py, f64>,
) -> PyResult<(
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let (n, all) = (table.shape()[0], table.shape()[1]);
    let widths = Widths {
        common: n_common,
        parameters: n_parameters,
        all,
    };
    let unknowns: usize = parts.iter().map(|part| part.3).sum();
    if root.len() != n || n_common + n_parameters > all || stds.len() != unknowns {
        return Err(PyValueError::new_err(format!(
            "expected {n} weights, {unknowns} deviations and at most {all} unknowns"
        )));
    }
    let table = table.as_slice().map_err(|_| not_contiguous("table"))?;
    let root = root.as_slice().map_err(|_| not_contiguous("root"))?;
    let stds = stds.as_slice().map_err(|_| not_contiguous("stds"))?;
    let mut lists = Vec::with_capacity(parts.len());
    for (rows, first, ..) in &parts {
        let (rows, first) = (starts(rows)?, starts(first)?);
        if rows.len() != first.len() || rows.iter().any(|&row| row >= n) {
            return Err(PyValueError::new_err(
                "expected windows of rows of the table",
            ));
        }
        lists.push((rows, first));
    }
    let (mut local, mut begin) = (Vec::with_capacity(parts.len()), 0);
    for ((_, _, entries, count), (rows, first)) in parts.iter().zip(&lists) {
        let none = Windows {
            first: &[],
            entries: &[],
            width: 0,
            unknowns: *count,
        };
        local.push(Part {
            rows,
            windows: match entries.len() {
                0 => none,
                _ => windows(first, entries, *count)?,
            },
            stds: &stds[begin..begin + count],
        });
        begin += count;
    }
    let reduced = py
        .detach(|| reduction::reduce(table, root, widths, &local))
        .ok_or_else(|| PyValueError::new_err("expected finite equations"))?;
    Ok((
        reduced.scale.into_pyarray(py),
        reduced.own.into_pyarray(py).reshape([n, all])?,
        reduced.below.into_pyarray(py).reshape([unknowns, all])?,
        reduced.leverage.into_pyarray(py),
        reduced.factor.into_pyarray(py).reshape([all; 2])?,
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
