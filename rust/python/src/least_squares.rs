//! Least squares with windows of unknowns: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_numerics::elimination::Windows;
use strainwave_numerics::reduction::{self, Equations, Part};
use strainwave_numerics::{blocks, solution};

use crate::arguments::{Matrix, Vector};
use crate::statespace::not_contiguous;

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(reduce, module)?)?;
    module.add_function(wrap_pyfunction!(solve, module)?)?;
    module.add_function(wrap_pyfunction!(huber_roots, module)?)?;
    module.add_function(wrap_pyfunction!(window_products, module)?)?;
    module.add_function(wrap_pyfunction!(block_products, module)?)
}

/// Rows, first unknowns, regressors and number of local unknowns.
type LocalPart<'py> = (
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray1<'py, i64>,
    Matrix<'py>,
    usize,
);

/// Weighted equations: regressors of the common unknowns (rows, common unknowns) and their standard
/// deviations, regressors of the parameters, targets (rows, sides), square roots of the weights,
/// local parts, and the standard deviations of all local unknowns.
type Arrays<'py> = (
    Matrix<'py>,
    Vector<'py>,
    Matrix<'py>,
    Matrix<'py>,
    Vector<'py>,
    Vec<LocalPart<'py>>,
    Vector<'py>,
);

/// Computes something of weighted equations without the GIL.
fn compute<T: Send>(
    py: Python<'_>,
    (common, common_stds, shared, targets, root, parts, stds): &Arrays<'_>,
    of: impl FnOnce(Equations<'_>) -> Option<T> + Send,
) -> PyResult<T> {
    let (n, unknowns) = (root.len(), parts.iter().map(|part| part.3).sum::<usize>());
    let heights = [common.shape()[0], shared.shape()[0], targets.shape()[0]];
    if heights != [n; 3] || common_stds.len() != common.shape()[1] || stds.len() != unknowns {
        return Err(PyValueError::new_err(format!(
            "expected {n} rows, got {heights:?}; {} and {unknowns} standard deviations, got {} and {}",
            common.shape()[1],
            common_stds.len(),
            stds.len()
        )));
    }
    let stds = vector(stds, "stds")?;
    let mut lists = Vec::with_capacity(parts.len());
    for (rows, first, ..) in parts {
        let (rows, first) = (indices(rows)?, indices(first)?);
        if rows.len() != first.len() || rows.iter().any(|&row| row >= n) {
            return Err(PyValueError::new_err(
                "expected windows of rows of the equations",
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
    let equations = Equations {
        common: matrix(common, "common")?,
        common_stds: vector(common_stds, "common_stds")?,
        shared: matrix(shared, "shared")?,
        parameters: shared.shape()[1],
        targets: matrix(targets, "targets")?,
        sides: targets.shape()[1],
        root: vector(root, "root")?,
        parts: &local,
    };
    if equations.columns() == 0 {
        return Err(PyValueError::new_err("expected unknowns or targets"));
    }
    py.detach(|| of(equations))
        .ok_or_else(|| PyValueError::new_err("expected finite equations"))
}

/// Weighted equations without their local unknowns: norms of the parameters' columns, rows,
/// regression on the local unknowns, leverages, triangular factor.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn reduce<'py>(
    py: Python<'py>,
    equations: Arrays<'py>,
) -> PyResult<(
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let all = equations.0.shape()[1] + equations.2.shape()[1] + equations.3.shape()[1];
    let reduced = compute(py, &equations, reduction::reduce)?;
    Ok((
        reduced.scale.into_pyarray(py),
        table(py, reduced.own, all)?,
        table(py, reduced.below, all)?,
        reduced.leverage.into_pyarray(py),
        table(py, reduced.factor, all)?,
    ))
}

/// Solution of weighted equations for each target: parameters, common and local unknowns,
/// residuals; norms of the parameters' columns, singular values, directions, whether they are
/// resolved, leverages.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn solve<'py>(
    py: Python<'py>,
    equations: Arrays<'py>,
    noise: Vector<'py>,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
)> {
    let (parameters, sides) = (equations.2.shape()[1], equations.3.shape()[1]);
    let noise = vector(&noise, "noise")?;
    if parameters == 0 || sides == 0 || noise.len() != parameters {
        return Err(PyValueError::new_err(format!(
            "expected targets, and parameters with as many numbers of noise, got {sides}, {parameters} and {}",
            noise.len()
        )));
    }
    let solution = compute(py, &equations, |equations| {
        solution::solve(equations, noise)
    })?;
    Ok((
        table(py, solution.value, sides)?,
        table(py, solution.common, sides)?,
        table(py, solution.local, sides)?,
        table(py, solution.residual, sides)?,
        solution.scale.into_pyarray(py),
        solution.singular.into_pyarray(py),
        table(py, solution.directions, parameters)?,
        solution.resolved.into_pyarray(py),
        solution.leverage.into_pyarray(py),
    ))
}

/// Square roots of Huber's weights of residuals.
#[pyfunction]
fn huber_roots<'py>(
    py: Python<'py>,
    residual: Vector<'py>,
    leverage: Vector<'py>,
    target: Vector<'py>,
    group: PyReadonlyArray1<'py, i64>,
    std_per_median: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let group = group.as_slice().map_err(|_| not_contiguous("group"))?;
    let (residual, leverage, target) = (
        vector(&residual, "residual")?,
        vector(&leverage, "leverage")?,
        vector(&target, "target")?,
    );
    let sizes = [leverage.len(), target.len(), group.len()];
    if sizes != [residual.len(); 3] {
        return Err(PyValueError::new_err(format!(
            "expected {} leverages, targets and groups, got {sizes:?}",
            residual.len()
        )));
    }
    let roots = solution::huber_roots(residual, leverage, target, group, std_per_median);
    Ok(roots.into_pyarray(py))
}

/// Products of all columns without the local unknowns: their sum, the contribution of each block of
/// rows, and that of the errors of the priors.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn block_products<'py>(
    py: Python<'py>,
    equations: Arrays<'py>,
    block: PyReadonlyArray1<'py, i64>,
    count: usize,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let all = equations.0.shape()[1] + equations.2.shape()[1] + equations.3.shape()[1];
    let block = block.as_slice().map_err(|_| not_contiguous("block"))?;
    let block: Vec<Option<usize>> = block.iter().map(|&at| usize::try_from(at).ok()).collect();
    let is_beyond = |at: &Option<usize>| at.is_some_and(|at| at >= count);
    if block.len() != equations.4.len() || block.iter().any(is_beyond) {
        return Err(PyValueError::new_err(format!(
            "expected one of {count} blocks for each of {} rows",
            equations.4.len()
        )));
    }
    let products = compute(py, &equations, |equations| {
        let is_prior = |row: &usize| block[*row].is_none();
        let mut rows = equations.parts.iter().flat_map(|part| part.rows);
        (!rows.any(is_prior)).then(|| blocks::block_products(equations, &block, count))?
    })?;
    Ok((
        table(py, products.total, all)?,
        products
            .blocks
            .into_pyarray(py)
            .reshape([count, all, all])?,
        table(py, products.priors, all)?,
    ))
}

/// Products of windows with the unknowns that they contain.
#[pyfunction]
fn window_products<'py>(
    py: Python<'py>,
    first: PyReadonlyArray1<'py, i64>,
    entries: Matrix<'py>,
    unknowns: Vector<'py>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (first, count) = (indices(&first)?, unknowns.len());
    let products = match entries.len() {
        0 => vec![0.0; entries.shape()[0]],
        _ => windows(&first, &entries, count)?.products(vector(&unknowns, "unknowns")?),
    };
    Ok(products.into_pyarray(py))
}

/// An array with rows of `width` numbers.
fn table<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    width: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = values.len() / width;
    values.into_pyarray(py).reshape([rows, width])
}

fn matrix<'a>(array: &'a Matrix<'_>, name: &str) -> PyResult<&'a [f64]> {
    array.as_slice().map_err(|_| not_contiguous(name))
}

fn vector<'a>(array: &'a Vector<'_>, name: &str) -> PyResult<&'a [f64]> {
    array.as_slice().map_err(|_| not_contiguous(name))
}

fn indices(array: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let negative = |_| PyValueError::new_err("expected indices of rows and unknowns");
    let array = array.as_slice().map_err(|_| not_contiguous("indices"))?;
    array
        .iter()
        .map(|&at| usize::try_from(at).map_err(negative))
        .collect()
}

fn windows<'a>(
    first: &'a [usize],
    entries: &'a Matrix<'_>,
    unknowns: usize,
) -> PyResult<Windows<'a>> {
    let width = entries.shape()[1];
    let entries = matrix(entries, "entries")?;
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
