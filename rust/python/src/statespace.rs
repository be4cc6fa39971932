//! State-space models in innovations form: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_statespace::fit::{Fit, InvalidStart, Options, Status, fit};
use strainwave_statespace::model::{Model, Record, Shape, split};
use strainwave_statespace::sensitivity::Entries;
use strainwave_statespace::steady_state::{self, Noise};
use strainwave_statespace::{hankel, predictor, sensitivity};

/// Adds this file's functions and classes to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(hankel_gram, module)?)?;
    module.add_function(wrap_pyfunction!(gramian, module)?)?;
    module.add_function(wrap_pyfunction!(innovations_gain, module)?)?;
    module.add_class::<Innovations>()?;
    module.add_class::<InnovationsFit>()
}

/// Z'Z of the block-Hankel matrix Z of stacked records z = [u, y], with its columns in an order, and
/// the number of its rows.
#[pyfunction]
fn hankel_gram<'py>(
    py: Python<'py>,
    inputs: PyReadonlyArray2<'py, f64>,
    outputs: PyReadonlyArray2<'py, f64>,
    lengths: Vec<usize>,
    depth: usize,
    order: Vec<usize>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, usize)> {
    check_rows("inputs", inputs.shape()[0], &lengths)?;
    check_rows("outputs", outputs.shape()[0], &lengths)?;
    let shape = Shape {
        order: 1,
        inputs: inputs.shape()[1],
        outputs: outputs.shape()[1],
    };
    let size = depth * (shape.inputs + shape.outputs);
    if order.len() != size || order.iter().any(|&column| column >= size) {
        return Err(PyValueError::new_err(format!(
            "expected an order of {size} columns"
        )));
    }
    let inputs = inputs.as_slice().map_err(|_| not_contiguous("inputs"))?;
    let outputs = outputs.as_slice().map_err(|_| not_contiguous("outputs"))?;
    let (gram, rows) = py.detach(|| {
        let records = split(shape, inputs, outputs, &lengths);
        hankel::gram(shape, &records, depth, &order)
    });
    Ok((gram.into_pyarray(py).reshape([size, size])?, rows))
}

/// X = A X A' + B B' for stable A.
#[pyfunction]
fn gramian<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let n = a.shape()[0];
    let (a, b) = (entries(&a, [n, n])?, entries(&b, [n, b.shape()[1]])?);
    steady_state::gramian(&a, &b, n)
        .into_pyarray(py)
        .reshape([n, n])
}

/// Gain of the steady-state Kalman predictor and covariance of its innovations.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn innovations_gain<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    c: PyReadonlyArray2<'py, f64>,
    state: PyReadonlyArray2<'py, f64>,
    cross: PyReadonlyArray2<'py, f64>,
    output: PyReadonlyArray2<'py, f64>,
) -> PyResult<Option<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)>> {
    let (n, p) = (a.shape()[0], c.shape()[0]);
    let noise = Noise {
        state: &entries(&state, [n, n])?,
        cross: &entries(&cross, [n, p])?,
        output: &entries(&output, [p, p])?,
    };
    let (a, c) = (entries(&a, [n, n])?, entries(&c, [p, n])?);
    steady_state::innovations_gain(&a, &c, noise, n, p)
        .map(|(gain, covariance)| {
            Ok((
                gain.into_pyarray(py).reshape([n, p])?,
                covariance.into_pyarray(py).reshape([p, p])?,
            ))
        })
        .transpose()
}

/// Entries of a matrix by rows.
fn entries(matrix: &PyReadonlyArray2<'_, f64>, shape: [usize; 2]) -> PyResult<Vec<f64>> {
    if matrix.shape() != shape {
        return Err(PyValueError::new_err(format!(
            "expected a matrix {shape:?}, got {:?}",
            matrix.shape()
        )));
    }
    Ok(matrix.as_array().iter().copied().collect())
}

/// Stacked records and the sizes of a model for them. `values` are A, B, C, D, K, row-major, and
/// one initial state per record.
#[pyclass(frozen, module = "strainwave._core")]
struct Innovations {
    shape: Shape,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    lengths: Vec<usize>,
}

#[pymethods]
impl Innovations {
    #[new]
    fn new(
        order: usize,
        inputs: PyReadonlyArray2<'_, f64>,
        outputs: PyReadonlyArray2<'_, f64>,
        lengths: Vec<usize>,
    ) -> PyResult<Self> {
        check_rows("inputs", inputs.shape()[0], &lengths)?;
        check_rows("outputs", outputs.shape()[0], &lengths)?;
        let shape = Shape {
            order,
            inputs: inputs.shape()[1],
            outputs: outputs.shape()[1],
        };
        if order == 0 || shape.inputs == 0 || shape.outputs == 0 {
            return Err(PyValueError::new_err(format!(
                "expected a model, got {shape:?}"
            )));
        }
        Ok(Self {
            shape,
            inputs: inputs
                .as_slice()
                .map_err(|_| not_contiguous("inputs"))?
                .to_vec(),
            outputs: outputs
                .as_slice()
                .map_err(|_| not_contiguous("outputs"))?
                .to_vec(),
            lengths,
        })
    }

    /// e[k] = y[k] - C x[k] - D u[k]: (n_samples, n_outputs).
    fn residuals<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let model = self.model(&values)?;
        let e = py.detach(|| predictor::innovations(&model, &self.records()));
        let p = self.shape.outputs;
        let samples = e.len() / p;
        e.into_pyarray(py).reshape([samples, p])
    }

    /// d e / d values: (n_samples, n_outputs, n_entries + order); the last columns are those of the
    /// initial state of the sample's record.
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let model = self.model(&values)?;
        let stacked = py.detach(|| {
            let records = self.records();
            let parts = records.iter().enumerate();
            parts
                .flat_map(|(index, r)| sensitivity::jacobian(&model, r, index))
                .collect::<Vec<_>>()
        });
        let (p, columns) = (self.shape.outputs, self.columns());
        let samples = stacked.len() / (p * columns);
        stacked.into_pyarray(py).reshape([samples, p, columns])
    }

    /// Scores e' W (d e / d values) of every sample: (n_samples, n_entries + order); W^-1 = L L'.
    fn scores<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
        whitener: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let model = self.model(&values)?;
        let whitener = self.whitener(&whitener)?;
        let stacked = py.detach(|| {
            let records = self.records();
            let parts = records.iter().enumerate();
            parts
                .flat_map(|(index, r)| sensitivity::scores(&model, r, index, &whitener))
                .collect::<Vec<_>>()
        });
        let columns = self.columns();
        let samples = stacked.len() / columns;
        stacked.into_pyarray(py).reshape([samples, columns])
    }

    /// J'WJ (size, size) and J'We (size,) with respect to `values`; W^-1 = L L'.
    ///
    /// `entries`: "all"; "linear": B, D and the initial states; "without-feedthrough": B and the
    /// initial states; "initial-states". Sums with other entries are zero.
    #[allow(clippy::type_complexity)]
    fn normal_equations<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
        whitener: PyReadonlyArray2<'py, f64>,
        entries: &str,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let entries = match entries {
            "all" => Entries::All,
            "linear" => Entries::Linear,
            "without-feedthrough" => Entries::WithoutFeedthrough,
            "initial-states" => Entries::InitialStates,
            _ => {
                return Err(PyValueError::new_err(format!(
                    "expected all, linear, without-feedthrough or initial-states, got {entries}"
                )));
            }
        };
        let model = self.model(&values)?;
        let whitener = self.whitener(&whitener)?;
        let equations = py
            .detach(|| sensitivity::normal_equations(&model, &self.records(), &whitener, entries));
        let size = model.values.len();
        Ok((
            equations.hessian.into_pyarray(py).reshape([size, size])?,
            equations.gradient.into_pyarray(py),
        ))
    }

    /// Prediction-error fit from a starting model with a stable predictor, and with a stable A if
    /// `stable`.
    #[allow(clippy::too_many_arguments)]
    fn fit(
        &self,
        py: Python<'_>,
        values: PyReadonlyArray1<'_, f64>,
        gain: bool,
        feedthrough: Vec<bool>,
        initial_states: bool,
        stable: bool,
        floor: Vec<f64>,
        max_iterations: usize,
        tolerance: f64,
    ) -> PyResult<InnovationsFit> {
        let start = self.model(&values)?;
        if feedthrough.len() != self.shape.inputs || floor.len() != self.shape.outputs {
            return Err(PyValueError::new_err(
                "expected a flag per input, a variance per output",
            ));
        }
        let options = Options {
            gain,
            feedthrough,
            initial_states,
            stable,
            floor,
            max_iterations,
            tolerance,
        };
        let ended = py.detach(|| fit(start, &self.records(), &options));
        match ended {
            Ok(fit) => Ok(InnovationsFit { fit }),
            Err(InvalidStart::Unstable) => Err(PyValueError::new_err(
                "expected a starting model with a stable predictor",
            )),
            Err(InvalidStart::NotFinite) => Err(PyValueError::new_err(
                "expected finite innovations of the starting model",
            )),
        }
    }
}

impl Innovations {
    fn records(&self) -> Vec<Record<'_>> {
        split(self.shape, &self.inputs, &self.outputs, &self.lengths)
    }

    fn columns(&self) -> usize {
        self.shape.entries() + self.shape.order
    }

    fn model(&self, values: &PyReadonlyArray1<'_, f64>) -> PyResult<Model> {
        let expected = self.shape.initial_state(self.lengths.len()).start;
        if values.len() != expected {
            return Err(PyValueError::new_err(format!(
                "expected {expected} values, got {}",
                values.len()
            )));
        }
        let values = values
            .as_slice()
            .map_err(|_| not_contiguous("values"))?
            .to_vec();
        Ok(Model {
            shape: self.shape,
            values,
        })
    }

    fn whitener(&self, factor: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<f64>> {
        let p = self.shape.outputs;
        if factor.shape() != [p, p] {
            return Err(PyValueError::new_err(format!(
                "expected a ({p}, {p}) whitener"
            )));
        }
        Ok(factor
            .as_slice()
            .map_err(|_| not_contiguous("whitener"))?
            .to_vec())
    }
}

/// Result of a prediction-error fit.
#[pyclass(frozen, module = "strainwave._core")]
struct InnovationsFit {
    fit: Fit,
}

#[pymethods]
impl InnovationsFit {
    /// The best model.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.fit.model.values)
    }

    /// E'E/N: (n_outputs, n_outputs).
    #[getter]
    fn innovation_covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let p = self.fit.model.shape.outputs;
        PyArray1::from_slice(py, &self.fit.innovation_covariance).reshape([p, p])
    }

    /// Covariance of `values`; None if the data do not determine a direction.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let size = self.fit.model.values.len();
        let covariance = self.fit.covariance.as_ref();
        covariance
            .map(|c| PyArray1::from_slice(py, c).reshape([size, size]))
            .transpose()
    }

    #[getter]
    fn cost(&self) -> f64 {
        self.fit.cost
    }

    #[getter]
    fn predicted_decrease(&self) -> f64 {
        self.fit.predicted_decrease
    }

    #[getter]
    fn n_parameters(&self) -> usize {
        self.fit.n_parameters
    }

    #[getter]
    fn iterations(&self) -> usize {
        self.fit.iterations
    }

    #[getter]
    fn evaluations(&self) -> usize {
        self.fit.evaluations
    }

    #[getter]
    fn status(&self) -> &'static str {
        match self.fit.status {
            Status::Converged => "converged",
            Status::IterationLimit => "iteration-limit",
            Status::Stalled => "stalled",
        }
    }
}

fn check_rows(name: &str, rows: usize, lengths: &[usize]) -> PyResult<()> {
    let expected: usize = lengths.iter().sum();
    if rows == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(format!(
        "expected {expected} rows of {name}, got {rows}"
    )))
}

/// The error for an array that is not contiguous.
pub fn not_contiguous(name: &str) -> PyErr {
    PyValueError::new_err(format!("expected {name} row-major and contiguous"))
}
