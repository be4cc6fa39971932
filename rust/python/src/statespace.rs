//! State-space models in innovations form: convert, compute without the GIL, map the error.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_statespace::fit::{Fit, InvalidStart, Options, Status, fit};
use strainwave_statespace::linear::{Entries, estimate};
use strainwave_statespace::model::{Model, Record, Shape, split};
use strainwave_statespace::subspace::{self, Method};
use strainwave_statespace::{predictor, sensitivity, stability, steady_state};

/// Adds this file's functions and classes to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("DIVERGENCE_RATIO", predictor::DIVERGENCE_RATIO)?;
    module.add_function(wrap_pyfunction!(balancing, module)?)?;
    module.add_function(wrap_pyfunction!(stabilising_gain, module)?)?;
    module.add_function(wrap_pyfunction!(is_stable, module)?)?;
    module.add_class::<Innovations>()?;
    module.add_class::<InnovationsFit>()?;
    module.add_class::<Subspace>()
}

/// State transformation that balances the predictor of (A, B, C, K); None if there is none.
#[pyfunction]
fn balancing<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    c: PyReadonlyArray2<'py, f64>,
    k: PyReadonlyArray2<'py, f64>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    let shape = Shape {
        order: a.shape()[0],
        inputs: b.shape()[1],
        outputs: c.shape()[0],
    };
    let (n, m, p) = (shape.order, shape.inputs, shape.outputs);
    let mut values = entries(&a, [n, n])?;
    values.extend(entries(&b, [n, m])?);
    values.extend(entries(&c, [p, n])?);
    values.extend(std::iter::repeat_n(0.0, p * m));
    values.extend(entries(&k, [n, p])?);
    steady_state::balancing(&Model { shape, values })
        .map(|(forward, _)| forward.into_pyarray(py).reshape([n, n]))
        .transpose()
}

/// Gain of a stable predictor with the noise spectrum of the gain K and of a covariance.
#[pyfunction]
fn stabilising_gain<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    c: PyReadonlyArray2<'py, f64>,
    k: PyReadonlyArray2<'py, f64>,
    covariance: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (n, p) = (a.shape()[0], c.shape()[0]);
    let (a, c) = (entries(&a, [n, n])?, entries(&c, [p, n])?);
    let (k, covariance) = (entries(&k, [n, p])?, entries(&covariance, [p, p])?);
    steady_state::stabilising_gain(&a, &c, k, &covariance, n, p)
        .into_pyarray(py)
        .reshape([n, p])
}

/// Whether all eigenvalues of a square matrix are inside the unit circle.
#[pyfunction]
fn is_stable(matrix: PyReadonlyArray2<'_, f64>) -> PyResult<bool> {
    let n = matrix.shape()[0];
    Ok(stability::is_stable(&entries(&matrix, [n, n])?, n))
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
    /// Rows [u, y]; not copied.
    samples: Py<PyArray2<f64>>,
    lengths: Vec<usize>,
}

#[pymethods]
impl Innovations {
    #[new]
    fn new(
        order: usize,
        n_inputs: usize,
        samples: PyReadonlyArray2<'_, f64>,
        lengths: Vec<usize>,
    ) -> PyResult<Self> {
        let [rows, width] = [samples.shape()[0], samples.shape()[1]];
        let expected: usize = lengths.iter().sum();
        if rows != expected {
            return Err(PyValueError::new_err(format!(
                "expected {expected} rows of samples, got {rows}"
            )));
        }
        if order == 0 || n_inputs == 0 || n_inputs >= width {
            return Err(PyValueError::new_err(format!(
                "expected a model, got order {order} and {n_inputs} inputs of {width} channels"
            )));
        }
        samples.as_slice().map_err(|_| not_contiguous("samples"))?;
        let shape = Shape {
            order,
            inputs: n_inputs,
            outputs: width - n_inputs,
        };
        Ok(Self {
            shape,
            samples: (*samples).clone().unbind(),
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
        let e = self.with_records(py, |records| predictor::innovations(&model, records))?;
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
        let stacked = self.with_records(py, |records| {
            let parts = records.iter().enumerate();
            parts
                .flat_map(|(index, r)| sensitivity::jacobian(&model, r, index))
                .collect::<Vec<_>>()
        })?;
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
        let stacked = self.with_records(py, |records| {
            let parts = records.iter().enumerate();
            parts
                .flat_map(|(index, r)| sensitivity::scores(&model, r, index, &whitener))
                .collect::<Vec<_>>()
        })?;
        let columns = self.columns();
        let samples = stacked.len() / columns;
        stacked.into_pyarray(py).reshape([samples, columns])
    }

    /// J'WJ (size, size) and J'We (size,) with respect to `values`; W^-1 = L L'.
    #[allow(clippy::type_complexity)]
    fn normal_equations<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
        whitener: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let model = self.model(&values)?;
        let whitener = self.whitener(&whitener)?;
        let equations = self.with_records(py, |records| {
            sensitivity::normal_equations(&model, records, &whitener)
        })?;
        let size = model.values.len();
        Ok((
            equations.hessian.into_pyarray(py).reshape([size, size])?,
            equations.gradient.into_pyarray(py),
        ))
    }

    /// `values` with B, D and the initial states by least squares, or without `feedthrough` the
    /// initial states only; None if the predictor overflows.
    #[pyo3(signature = (values, feedthrough, floor))]
    fn linear<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'py, f64>,
        feedthrough: Option<Vec<bool>>,
        floor: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let mut model = self.model(&values)?;
        if let Some(flags) = &feedthrough {
            check_flags(flags, self.shape)?;
        }
        let entries = feedthrough
            .as_deref()
            .map_or(Entries::InitialStates, Entries::Plant);
        let is_finite =
            self.with_records(py, |records| estimate(&mut model, records, entries, floor))?;
        Ok(is_finite.then(|| model.values.into_pyarray(py)))
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
        check_flags(&feedthrough, self.shape)?;
        if floor.len() != self.shape.outputs {
            return Err(PyValueError::new_err("expected a variance per output"));
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
        let ended = self.with_records(py, |records| fit(start, records, &options))?;
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
    /// Calls a function with the records, without the GIL.
    fn with_records<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&[Record<'_>]) -> T + Send,
    ) -> PyResult<T> {
        let samples = self.samples.bind(py).try_readonly()?;
        let samples = samples.as_slice()?;
        let records = split(self.shape, samples, &self.lengths);
        Ok(py.detach(|| work(&records)))
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

/// Subspace methods for the data of `Innovations` and one horizon; factors are kept.
#[pyclass(frozen, module = "strainwave._core")]
struct Subspace {
    data: Py<Innovations>,
    factors: subspace::Subspace,
}

#[pymethods]
impl Subspace {
    #[new]
    fn new(data: Bound<'_, Innovations>, horizon: usize) -> Self {
        Self {
            factors: subspace::Subspace::new(data.get().shape, horizon),
            data: data.unbind(),
        }
    }

    /// R of [u[k], z[k-1], ..., z[k-horizon], y[k]] and the number of rows of the data.
    fn regression<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<f64>>, usize)> {
        let data = self.data.get();
        let (factor, rows) =
            data.with_records(py, |records| self.factors.regression(records).clone())?;
        let size = factor.len().isqrt();
        Ok((factor.into_pyarray(py).reshape([size, size])?, rows))
    }

    /// Order, balanced model with zero initial states as values of `Innovations`, singular values.
    #[pyo3(signature = (method, feedthrough, floor, *, order, max_order))]
    #[allow(clippy::type_complexity)]
    fn realise<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        feedthrough: Vec<bool>,
        floor: f64,
        order: Option<usize>,
        max_order: usize,
    ) -> PyResult<(usize, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let method = match method {
            "moesp" => Method::Moesp,
            "n4sid" => Method::N4sid,
            "predictor" => Method::Predictor,
            _ => {
                return Err(PyValueError::new_err(format!(
                    "expected moesp, n4sid or predictor, got {method}"
                )));
            }
        };
        let data = self.data.get();
        check_flags(&feedthrough, data.shape)?;
        let options = subspace::Options {
            order,
            max_order,
            feedthrough: &feedthrough,
            floor,
        };
        let (model, singular_values) = data.with_records(py, |records| {
            self.factors.realise(records, method, &options)
        })?;
        let values = model.values.into_pyarray(py);
        Ok((model.shape.order, values, singular_values.into_pyarray(py)))
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

fn check_flags(flags: &[bool], shape: Shape) -> PyResult<()> {
    if flags.len() == shape.inputs {
        return Ok(());
    }
    Err(PyValueError::new_err("expected a flag per input"))
}

/// The error for an array that is not contiguous.
pub fn not_contiguous(name: &str) -> PyErr {
    PyValueError::new_err(format!("expected {name} row-major and contiguous"))
}
