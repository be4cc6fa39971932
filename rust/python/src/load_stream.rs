//! Python class of a stream of samples with a load.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_arms::load_stream::{self as core, Law, Settings, Term};

use crate::arguments::{Matrix, Vector, per_joint, rows};
use crate::arm::Arm;

/// Samples of an arm with a load; see _core.pyi.
#[pyclass(frozen, module = "strainwave._core")]
pub struct LoadStream {
    arm: Py<Arm>,
    chain: Option<Py<Arm>>,
    joints: usize,
    stream: Mutex<core::LoadStream>,
}

/// Factors and products of all blocks.
type Blocks<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

#[pymethods]
impl LoadStream {
    #[new]
    #[pyo3(signature = (arm, *, chain, sample_time, bandwidth_hz, motion_poles_hz, samples_per_row,
        rows_per_block, blocks, transmission, inverse, links, motor_inertia, friction, shared,
        terms, compliance, zero, per_command, decay, delay, slow, weight))]
    fn new(
        py: Python<'_>,
        arm: Py<Arm>,
        chain: Option<Py<Arm>>,
        sample_time: f64,
        bandwidth_hz: f64,
        motion_poles_hz: f64,
        samples_per_row: usize,
        rows_per_block: usize,
        blocks: usize,
        transmission: Matrix<'_>,
        inverse: Matrix<'_>,
        links: Vec<f64>,
        motor_inertia: Vec<f64>,
        friction: Matrix<'_>,
        shared: Vec<(usize, f64)>,
        terms: Vec<(String, usize, f64, f64)>,
        compliance: Vec<f64>,
        zero: Vec<f64>,
        per_command: Vec<f64>,
        decay: Vec<f64>,
        delay: Vec<f64>,
        slow: Vec<f64>,
        weight: Vec<f64>,
    ) -> PyResult<Self> {
        let joints = arm.bind(py).get().n_joints();
        let each = |values, name| per_joint(Some(values), 0.0, joints, name);
        let of_load = chain.as_ref().unwrap_or(&arm).bind(py).get().core();
        let parameters = arm.bind(py).get().core().base_parameters();
        if links.len() != parameters || of_load.base_parameters() != core::BODY * joints {
            let text = format!("expected {parameters} links, and a chain of {joints} joints");
            return Err(PyValueError::new_err(text));
        }
        if samples_per_row == 0 || rows_per_block == 0 || blocks == 0 {
            let text = "expected at least one sample a row, one row a block, and one block";
            return Err(PyValueError::new_err(text));
        }
        let settings = Settings {
            sample_time,
            bandwidth: bandwidth_hz,
            motion_poles: motion_poles_hz,
            samples_per_row,
            rows_per_block,
            blocks,
            transmission: rows(&transmission, "transmission", joints, joints)?,
            inverse: rows(&inverse, "inverse", joints, joints)?,
            links,
            motor_inertia: each(motor_inertia, "motor_inertia")?,
            friction: rows(&friction, "friction", joints, core::FRICTION)?,
            shared: checked(shared, joints, |s| s.0)?,
            terms: checked(terms, joints, |t| t.1)?
                .into_iter()
                .map(term)
                .collect::<PyResult<_>>()?,
            compliance: each(compliance, "compliance")?,
            zero: each(zero, "zero")?,
            per_command: each(per_command, "per_command")?,
            decay: each(decay, "decay")?,
            delay: each(delay, "delay")?,
            slow: each(slow, "slow")?,
            weight: each(weight, "weight")?,
        };
        Ok(Self {
            arm,
            chain,
            joints,
            stream: Mutex::new(core::LoadStream::new(settings, joints)),
        })
    }

    fn update(&self, py: Python<'_>, angle: Vector<'_>, input: Vector<'_>) -> PyResult<()> {
        let [angle, input] = [angle, input].map(|list| list.as_array().to_vec());
        if angle.len() != self.joints || input.len() != self.joints {
            return Err(PyValueError::new_err(format!(
                "expected {} angles and torques, got {} and {}",
                self.joints,
                angle.len(),
                input.len()
            )));
        }
        let arm = self.arm.get().core();
        let chain = self.chain.as_ref().map(|chain| chain.get().core());
        py.detach(|| self.stream().update(arm, chain, &angle, &input));
        Ok(())
    }

    fn reset(&self) {
        self.stream().reset();
    }

    fn equations<'py>(&self, py: Python<'py>) -> PyResult<Blocks<'py>> {
        let (mut factors, mut products, mut count) = (Vec::new(), Vec::new(), 0);
        for (factor, product) in self.stream().equations() {
            factors.extend_from_slice(factor);
            products.extend_from_slice(product);
            count += 1;
        }
        let n = core::FRICTION * self.joints + core::BODY;
        let arm_columns = if count == 0 {
            0
        } else {
            products.len() / (count * n)
        };
        Ok((
            factors.into_pyarray(py).reshape([count, n + 1, n + 1])?,
            products.into_pyarray(py).reshape([count, n, arm_columns])?,
        ))
    }
}

impl LoadStream {
    /// The stream, also after a panic in another thread.
    fn stream(&self) -> MutexGuard<'_, core::LoadStream> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn checked<T>(list: Vec<T>, joints: usize, joint: impl Fn(&T) -> usize) -> PyResult<Vec<T>> {
    match list.iter().all(|entry| joint(entry) < joints) {
        true => Ok(list),
        false => Err(PyValueError::new_err("expected joints of the arm, from 0")),
    }
}

fn term((name, joint, shape, size): (String, usize, f64, f64)) -> PyResult<Term> {
    let law = match name.as_str() {
        "load-friction" => Law::Load,
        "load-speed-friction" => Law::LoadSpeed,
        "direction-friction" => Law::Direction,
        "stribeck" => Law::Stribeck,
        "power-friction" => Law::Power,
        "ground-spring" => Law::Spring,
        _ => return Err(PyValueError::new_err(format!("no friction {name:?}"))),
    };
    Ok(Term {
        joint,
        law,
        shape,
        size,
    })
}
