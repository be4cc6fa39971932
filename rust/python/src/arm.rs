//! Python class of an arm.

use numpy::{PyArray1, PyArray2, PyArray3, PyArray4, PyArrayMethods};
use pyo3::exceptions::{PyFloatingPointError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use strainwave_arms::{Drives, Links, compiled_arm};
use strainwave_core::arm::Kinematics;
use strainwave_core::channels::{ChainRule, Channel};
use strainwave_core::compiled::{self, CompiledArm, Derivatives, InitialState, LinkMotion};
use strainwave_core::experiment::{Clock, Diverged, Source};
use strainwave_core::joint::gear;
use strainwave_core::program::Width;
use strainwave_core::sensitivity::Variant;
use strainwave_core::sensors::decimation::Decimation;

use crate::arguments::{
    JointPlacement, Joints, Matrix, Vector, chain_joints, per_joint, rows, same_rows, value_error,
};
use crate::experiment::{Experiment, LinkSensorArguments, ServoArguments, check_clock, quantities};

/// Name of a parameter or an initial state, and its joint from 1 if it belongs to a joint.
type Direction = (String, Option<usize>);
/// Message for taps of a wrong shape.
const TAPS: &str =
    "expected taps for each quantity recorded, of equal length, a multiple of samples_per_row";

/// An arm with its known constants; see _core.pyi.
#[pyclass(frozen, module = "strainwave._core")]
pub struct Arm(Box<dyn CompiledArm>);

/// Readings (rows, channels) and their derivatives (rows, channels, directions).
type Linearisation<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

#[pymethods]
impl Arm {
    #[new]
    #[pyo3(signature = (joints, springs, gear_ratio, *, program="serial", gravity=[0.0, 0.0, -9.81],
        transmission=None, torque_per_volt=None, current_loop_hz=None, encoder_counts=None,
        accelerometer_distance=None, accelerometer_hz=None, gyro_hz=None,
        imu_accelerometer_hz=None, imu_gyro_hz=None, effects=None, gear_corner=gear::CORNER))]
    fn new(
        joints: Vec<JointPlacement>,
        springs: Vec<String>,
        gear_ratio: Vec<f64>,
        program: &str,
        gravity: [f64; 3],
        transmission: Option<Vec<Vec<f64>>>,
        torque_per_volt: Option<Vec<f64>>,
        current_loop_hz: Option<Vec<Option<f64>>>,
        encoder_counts: Option<Vec<Option<f64>>>,
        accelerometer_distance: Option<Vec<f64>>,
        accelerometer_hz: Option<Vec<Option<f64>>>,
        gyro_hz: Option<Vec<Option<f64>>>,
        imu_accelerometer_hz: Option<Vec<Option<f64>>>,
        imu_gyro_hz: Option<Vec<Option<f64>>>,
        effects: Option<Vec<Vec<String>>>,
        gear_corner: f64,
    ) -> PyResult<Self> {
        let count = joints.len();
        let distances = per_joint(accelerometer_distance, 1.0, count, "accelerometer_distance")?;
        let constants = Joints {
            springs,
            gear_ratio,
            torque_per_volt,
            current_loop_hz,
            encoder_counts,
            accelerometer_hz,
            gyro_hz,
            imu_accelerometer_hz,
            imu_gyro_hz,
            effects,
        };
        let drives = Drives {
            joints: &constants.configs()?,
            corner: gear_corner,
        };
        let links = Links {
            joints: &chain_joints(&joints, &distances)?,
            gravity,
            transmission: &transmission.unwrap_or_default(),
        };
        let arm = compiled_arm(program, &links, &drives, Width::detect());
        Ok(Self(arm.map_err(value_error)?))
    }

    #[getter]
    pub fn n_joints(&self) -> usize {
        self.0.joints()
    }

    #[getter]
    fn parameter_names(&self) -> Vec<(&'static str, Option<usize>)> {
        self.0.parameter_names()
    }

    #[pyo3(signature = (voltage, *, motor_angle, step, steps_per_tick, steps_per_sample, samples,
        record, reference=None, servo=None, steps_per_servo=1, motor_velocity=None,
        link_angle=None, link_velocity=None, initial_voltage=None, link_sensors=None))]
    fn experiment(
        &self,
        voltage: Matrix<'_>,
        motor_angle: Vec<f64>,
        step: f64,
        steps_per_tick: usize,
        steps_per_sample: usize,
        samples: usize,
        record: Vec<String>,
        reference: Option<Matrix<'_>>,
        servo: Option<ServoArguments<'_>>,
        steps_per_servo: usize,
        motor_velocity: Option<Vec<f64>>,
        link_angle: Option<Vec<f64>>,
        link_velocity: Option<Vec<f64>>,
        initial_voltage: Option<Vec<f64>>,
        link_sensors: Option<Vec<LinkSensorArguments<'_>>>,
    ) -> PyResult<Experiment> {
        let clock = Clock {
            step,
            steps_per_tick,
            steps_per_servo,
            steps_per_sample,
            samples,
        };
        check_clock(&clock)?;
        let (joints, ticks) = (self.n_joints(), clock.ticks());
        let (quantities, link_sensors) =
            quantities(&record, &link_sensors.unwrap_or_default(), joints)?;
        let core = compiled::Experiment {
            clock,
            servo: servo.map(ServoArguments::settings).transpose()?,
            voltage: rows(&voltage, "voltage", ticks, joints)?,
            reference: match reference {
                Some(reference) => rows(&reference, "reference", ticks, joints)?,
                None => vec![0.0; ticks * joints],
            },
            initial: InitialState {
                motor_angle,
                motor_velocity,
                link_angle,
                link_velocity,
                voltage: initial_voltage,
            },
            record: quantities,
            link_sensors,
        };
        core.check(joints).map_err(value_error)?;
        Ok(Experiment {
            core,
            joints,
            record,
        })
    }

    #[getter]
    fn lanes(&self) -> usize {
        self.0.lanes()
    }

    fn simulate<'py>(
        &self,
        py: Python<'py>,
        parameters: Matrix<'py>,
        experiments: Vec<PyRef<'py, Experiment>>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let arms = parameters.as_array();
        if arms.nrows() != experiments.len() {
            let (rows, count) = (arms.nrows(), experiments.len());
            let text =
                format!("parameters has {rows} rows: expected one for each of {count} experiments");
            return Err(PyValueError::new_err(text));
        }
        let arms: Vec<Vec<f64>> = arms.rows().into_iter().map(|row| row.to_vec()).collect();
        let mut cases = Vec::with_capacity(arms.len());
        for (experiment, values) in experiments.iter().zip(&arms) {
            let experiment = experiment.of(self.n_joints())?;
            self.check(values)?;
            cases.push((experiment, &values[..]));
        }
        let recordings = py.detach(|| self.0.simulate(&cases)).map_err(divergence)?;
        let mut all = Vec::with_capacity(cases.len());
        for (experiment, recording) in experiments.iter().zip(recordings) {
            let shape = [experiment.core.clock.samples, self.n_joints()];
            let result = PyDict::new(py);
            for (name, column) in experiment.record.iter().zip(recording) {
                result.set_item(name, PyArray1::from_vec(py, column).reshape(shape)?)?;
            }
            all.push(result);
        }
        Ok(all)
    }

    fn sensitivities<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        experiment: &Experiment,
        with_respect_to: Vec<Direction>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let core = experiment.of(self.n_joints())?;
        let parameters = self.checked(&parameters)?;
        let directions = self.sources(&with_respect_to)?;
        let differentiate = || {
            self.0
                .sensitivities(core, &parameters, &directions, &[], None)
        };
        let Derivatives { values, tangents } = py.detach(differentiate).map_err(divergence)?;
        let shape = [core.clock.samples, self.n_joints()];
        let result = PyDict::new(py);
        for ((name, values), tangents) in experiment.record.iter().zip(values).zip(tangents) {
            let values: Bound<'py, PyArray2<f64>> =
                PyArray1::from_vec(py, values).reshape(shape)?;
            let tangents: Bound<'py, PyArray3<f64>> =
                PyArray1::from_vec(py, tangents).reshape([shape[0], shape[1], directions.len()])?;
            result.set_item(name, (values, tangents))?;
        }
        Ok(result)
    }

    #[pyo3(signature = (parameters, experiment, with_respect_to, channels, chain, *,
        variants=Vec::new(), taps=None, samples_per_row=1))]
    fn channel_sensitivities<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        experiment: &Experiment,
        with_respect_to: Vec<Direction>,
        channels: Vec<(usize, usize, f64)>,
        chain: Matrix<'py>,
        variants: Vec<(Vector<'py>, Vec<Direction>)>,
        taps: Option<Vec<Vec<f64>>>,
        samples_per_row: usize,
    ) -> PyResult<Linearisation<'py>> {
        let (joints, quantities) = (self.n_joints(), experiment.record.len());
        let core = experiment.of(joints)?;
        let decimation = match taps {
            None => None,
            Some(taps) if taps.len() == quantities => {
                let decimation = Decimation::new(taps, samples_per_row);
                Some(decimation.ok_or_else(|| PyValueError::new_err(TAPS))?)
            }
            Some(_) => return Err(PyValueError::new_err(TAPS)),
        };
        let decimation = decimation.as_ref();
        let parameters = self.checked(&parameters)?;
        let directions = self.sources(&with_respect_to)?;
        let mut others = Vec::with_capacity(variants.len());
        for (values, names) in &variants {
            others.push((self.checked(values)?, self.sources(names)?));
        }
        let variants: Vec<_> = others
            .iter()
            .map(|(parameters, directions)| Variant {
                parameters,
                directions,
            })
            .collect();
        let width = directions.len() + others.iter().map(|(_, more)| more.len()).sum::<usize>();
        let (directions_of_chain, columns) = chain.as_array().dim();
        if directions_of_chain != width {
            let text = format!("chain: expected {width} rows, got {directions_of_chain}");
            return Err(PyValueError::new_err(text));
        }
        let chain = ChainRule::new(&rows(&chain, "chain", width, columns)?, columns);
        let mut of_log = Vec::with_capacity(channels.len());
        for (quantity, joint, factor) in channels {
            if quantity >= quantities || joint >= joints {
                let text = format!("no quantity {quantity} of joint {joint}, from 0, is recorded");
                return Err(PyValueError::new_err(text));
            }
            of_log.push(Channel {
                quantity,
                joint,
                factor,
            });
        }
        let differentiate = || {
            self.0
                .sensitivities(core, &parameters, &directions, &variants, decimation)
                .map(|all| all.of_channels(joints, &of_log, &chain))
        };
        let (readings, derivatives) = py.detach(differentiate).map_err(divergence)?;
        let samples = core.clock.samples;
        let n_rows = decimation.map_or(samples, |all| all.rows(samples));
        let shape = [n_rows, of_log.len(), columns];
        let readings = PyArray1::from_vec(py, readings).reshape([shape[0], shape[1]])?;
        Ok((
            readings,
            PyArray1::from_vec(py, derivatives).reshape(shape)?,
        ))
    }

    fn base_regressor<'py>(
        &self,
        py: Python<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let shape = [
            angle.as_array().nrows(),
            self.n_joints(),
            self.0.base_parameters(),
        ];
        let work = |motion: &LinkMotion<'_>| self.0.base_regressor(motion);
        let regressor = self.along(py, [&angle, &velocity, &acceleration], work)?;
        PyArray1::from_vec(py, regressor).reshape(shape)
    }

    fn motor_regressor<'py>(
        &self,
        py: Python<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
        combinations: Matrix<'py>,
        transmission: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let (n, bases) = (self.n_joints(), self.0.base_parameters());
        let shape = [angle.as_array().nrows(), n, combinations.as_array().ncols()];
        let (height, square) = (
            combinations.as_array().nrows(),
            transmission.as_array().dim(),
        );
        if height != bases || square != (n, n) {
            return Err(PyValueError::new_err(format!(
                "expected combinations of {bases} base parameters and a transmission of {n} joints, got {height} and {square:?}"
            )));
        }
        let combinations = rows(&combinations, "combinations", 0, shape[2])?;
        let transmission = rows(&transmission, "transmission", 0, n)?;
        let work =
            |motion: &LinkMotion<'_>| self.0.motor_regressor(motion, &combinations, &transmission);
        let regressor = self.along(py, [&angle, &velocity, &acceleration], work)?;
        PyArray1::from_vec(py, regressor).reshape(shape)
    }

    fn link_torques<'py>(
        &self,
        py: Python<'py>,
        base: Vector<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [angle.as_array().nrows(), self.n_joints()];
        let base = self.base(&base)?;
        let work = |motion: &LinkMotion<'_>| self.0.link_torques(&base, motion);
        let torques = self.along(py, [&angle, &velocity, &acceleration], work)?;
        PyArray1::from_vec(py, torques).reshape(shape)
    }

    fn link_motion<'py>(
        &self,
        py: Python<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let n = self.n_joints();
        let [q, dq, ddq] = same_rows([&angle, &velocity, &acceleration], n)?;
        let motion = py.detach(|| self.0.kinematics().link_motion(&q, &dq, &ddq));
        PyArray1::from_vec(py, motion).reshape([q.len() / n, n, Kinematics::ENTRIES])
    }

    fn link_motion_derivatives<'py>(
        &self,
        py: Python<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<[Bound<'py, PyArray4<f64>>; 3]> {
        let n = self.n_joints();
        let [q, dq, ddq] = same_rows([&angle, &velocity, &acceleration], n)?;
        let differentiate = || self.0.kinematics().link_motion_derivatives(&q, &dq, &ddq);
        let [by_angle, by_velocity, by_acceleration] = py.detach(differentiate);
        let shape = [q.len() / n, n, Kinematics::ENTRIES, n];
        let array = |list| PyArray1::from_vec(py, list).reshape(shape);
        Ok([
            array(by_angle)?,
            array(by_velocity)?,
            array(by_acceleration)?,
        ])
    }

    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = self.checked(&parameters)?;
        let shape = [angle.as_array().nrows(), self.n_joints()];
        let work = |motion: &LinkMotion<'_>| self.0.inverse_dynamics(&values, motion);
        let torques = self.along(py, [&angle, &velocity, &acceleration], work)?;
        PyArray1::from_vec(py, torques).reshape(shape)
    }

    fn inertia_matrix<'py>(
        &self,
        py: Python<'py>,
        base: Vector<'py>,
        angle: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let base = self.base(&base)?;
        let n = self.n_joints();
        let q = rows(&angle, "angle", 0, n)?;
        let matrices = py.detach(|| self.0.inertia_matrix(&base, &q));
        PyArray1::from_vec(py, matrices).reshape([q.len() / n, n, n])
    }

    fn bias_torques<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = self.checked(&parameters)?;
        let n = self.n_joints();
        let [q, dq, _] = same_rows([&angle, &velocity, &velocity], n)?;
        let torques = py.detach(|| self.0.bias_torques(&values, &q, &dq));
        PyArray1::from_vec(py, torques).reshape([q.len() / n, n])
    }
}

impl Arm {
    /// The compiled arm.
    pub fn core(&self) -> &dyn CompiledArm {
        &*self.0
    }

    fn check(&self, values: &[f64]) -> PyResult<()> {
        let (expected, got) = (self.0.parameter_names().len(), values.len());
        if got != expected {
            let text = format!("expected {expected} parameters, got {got}");
            return Err(PyValueError::new_err(text));
        }
        self.0.check(values).map_err(value_error)
    }

    /// Results along a motion of the links, without the interpreter's lock.
    fn along(
        &self,
        py: Python<'_>,
        motion: [&Matrix<'_>; 3],
        work: impl FnOnce(&LinkMotion<'_>) -> Vec<f64> + Send,
    ) -> PyResult<Vec<f64>> {
        let [angle, velocity, acceleration] = same_rows(motion, self.n_joints())?;
        let motion = LinkMotion {
            angle: &angle,
            velocity: &velocity,
            acceleration: &acceleration,
        };
        Ok(py.detach(|| work(&motion)))
    }

    fn checked(&self, parameters: &Vector<'_>) -> PyResult<Vec<f64>> {
        let values = parameters.as_array().to_vec();
        self.check(&values)?;
        Ok(values)
    }

    /// Base parameters, physical or not.
    fn base(&self, base: &Vector<'_>) -> PyResult<Vec<f64>> {
        let base = base.as_array().to_vec();
        let (got, expected) = (base.len(), self.0.base_parameters());
        if got != expected {
            let message = format!("base has {got} values instead of {expected}");
            return Err(PyValueError::new_err(message));
        }
        Ok(base)
    }

    /// Parameters and initial states with these names.
    fn sources(&self, directions: &[Direction]) -> PyResult<Vec<Source>> {
        let names = self.0.parameter_names();
        let source = |(name, joint): &Direction| {
            let is_parameter = |known: &(&str, Option<usize>)| *known == (name.as_str(), *joint);
            if let Some(k) = names.iter().position(is_parameter) {
                return Ok(Source::Parameter(k));
            }
            let initial: Option<fn(usize) -> Source> = match name.as_str() {
                "initial_motor_angle" => Some(Source::MotorAngle),
                "initial_motor_velocity" => Some(Source::MotorVelocity),
                "initial_link_angle" => Some(Source::LinkAngle),
                "initial_link_velocity" => Some(Source::LinkVelocity),
                _ => None,
            };
            match (initial, joint) {
                (Some(state), Some(joint)) if (1..=self.n_joints()).contains(joint) => {
                    Ok(state(joint - 1))
                }
                _ => {
                    let owner = joint.map_or("the arm".to_owned(), |j| format!("joint {j}"));
                    Err(PyValueError::new_err(format!(
                        "unknown direction {name:?} of {owner}"
                    )))
                }
            }
        };
        directions.iter().map(source).collect()
    }
}

fn divergence(diverged: Diverged) -> PyErr {
    PyFloatingPointError::new_err(format!("the motion diverged at {} s", diverged.time))
}
