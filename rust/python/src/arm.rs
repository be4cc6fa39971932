//! The arm as a Python class.

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::{PyFloatingPointError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use strainwave_core::actuation::{PiPosition, PiVelocity, Servo};
use strainwave_core::arm::{self, OneLink, SerialChain, TwoLink};
use strainwave_core::dispatch::{self, Width};
use strainwave_core::experiment::{
    Clock, Diverged, Initial, Member, Quantity, Record, Source, Task,
};
use strainwave_core::joint::gear;
use strainwave_core::plant::config::{Config, JointConfig};
use strainwave_core::plant::rigid;
use strainwave_core::sensitivity::Sensitivities;
use strainwave_core::sensors::decimation::Decimation;

use crate::arguments::{
    Joints, Matrix, Placed, check_clock, fixed, given, of_joints, one_link, quantities, rows,
    same_rows, serial_chain, two_link,
};

type Vector<'py> = PyReadonlyArray1<'py, f64>;
/// kp, ki, limit, which joints, and the position loop's gains if there is one.
type ServoGiven = (Vec<f64>, Vec<f64>, f64, Vec<bool>, Option<Vec<f64>>);
/// A parameter's or an initial state's name, and its joint from 1 where it belongs to one.
type Direction = (String, Option<usize>);
const TAPS: &str =
    "expected taps for each quantity recorded, all as many, and a multiple of samples_per_row";
/// Values (samples, joints) and tangents (samples, joints, directions).
type WithTangents<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

/// [`Any`] of the arms that the core knows, and `each!`, which runs the same generic code on
/// whichever it is; `$` is what stands before the latter's own variables.
macro_rules! arms {
    ($dollar:tt $($name:ident: $arm:ty, $joints:literal;)*) => {
        /// An arm with its constants.
        enum Any {
            $($name(Box<Config<$arm, $joints>>),)*
        }

        macro_rules! each {
            ($dollar any:expr, $dollar config:ident => $dollar code:expr) => {
                match $dollar any {
                    $(Any::$name($dollar config) => $dollar code,)*
                }
            };
        }
    };
}

arms! { $
    TwoLinkLevel: TwoLink<false>, 2;
    TwoLinkUpright: TwoLink<true>, 2;
    OneLinkLevel: OneLink<false>, 1;
    OneLinkUpright: OneLink<true>, 1;
    Chain1: SerialChain<1>, 1;
    Chain2: SerialChain<2>, 2;
    Chain3: SerialChain<3>, 3;
    Chain4: SerialChain<4>, 4;
    Chain5: SerialChain<5>, 5;
    Chain6: SerialChain<6>, 6;
}

/// An arm with its known constants; see _core.pyi.
#[pyclass(frozen, module = "strainwave._core")]
pub struct Arm(Any);

/// What `simulate` and `sensitivities` take beside the parameters.
struct Experiment<'py> {
    voltage: Matrix<'py>,
    reference: Option<Matrix<'py>>,
    servo: Option<ServoGiven>,
    clock: Clock,
    motor_angle: Vec<f64>,
    motor_velocity: Option<Vec<f64>>,
    link_angle: Option<Vec<f64>>,
    link_velocity: Option<Vec<f64>>,
    initial_voltage: Option<Vec<f64>>,
    record: Vec<Quantity>,
}

#[pymethods]
impl Arm {
    #[new]
    #[pyo3(signature = (kind, springs, gear_ratio, *, torque_per_volt=None, link_length=0.0,
        gravity=0.0, current_loop_hz=None, encoder_counts=None, accelerometer_distance=None,
        accelerometer_hz=None, gyro_hz=None, imu_accelerometer_hz=None, imu_gyro_hz=None,
        effects=None, gear_corner=gear::CORNER))]
    fn new(
        kind: &str,
        springs: Vec<String>,
        gear_ratio: Vec<f64>,
        torque_per_volt: Option<Vec<f64>>,
        link_length: f64,
        gravity: f64,
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
        let distance = given(
            accelerometer_distance,
            1.0,
            springs.len(),
            "accelerometer_distance",
        )?;
        let joints = Joints {
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
        let known = (gear_corner, joints.configs()?);
        Ok(Self(match (kind, gravity != 0.0) {
            ("planar-two-link", false) => Any::TwoLinkLevel(configure(
                two_link(link_length, gravity, &distance)?,
                &known,
            )?),
            ("planar-two-link", true) => Any::TwoLinkUpright(configure(
                two_link(link_length, gravity, &distance)?,
                &known,
            )?),
            ("single-joint", false) => {
                Any::OneLinkLevel(configure(one_link(gravity, &distance)?, &known)?)
            }
            ("single-joint", true) => {
                Any::OneLinkUpright(configure(one_link(gravity, &distance)?, &known)?)
            }
            _ => return Err(PyValueError::new_err(format!("no arm of kind {kind:?}"))),
        }))
    }

    #[staticmethod]
    #[pyo3(signature = (joints, springs, gear_ratio, *, torque_per_volt=None,
        gravity=[0.0, 0.0, -9.81], current_loop_hz=None, encoder_counts=None,
        accelerometer_distance=None, accelerometer_hz=None, gyro_hz=None,
        imu_accelerometer_hz=None, imu_gyro_hz=None, effects=None, gear_corner=gear::CORNER))]
    fn serial_chain(
        joints: Vec<Placed>,
        springs: Vec<String>,
        gear_ratio: Vec<f64>,
        torque_per_volt: Option<Vec<f64>>,
        gravity: [f64; 3],
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
        let distance = given(
            accelerometer_distance,
            1.0,
            joints.len(),
            "accelerometer_distance",
        )?;
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
        let known = (gear_corner, constants.configs()?);
        macro_rules! chain {
            ($any:path) => {
                $any(configure(
                    serial_chain(&joints, gravity, &distance)?,
                    &known,
                )?)
            };
        }
        Ok(Self(match joints.len() {
            1 => chain!(Any::Chain1),
            2 => chain!(Any::Chain2),
            3 => chain!(Any::Chain3),
            4 => chain!(Any::Chain4),
            5 => chain!(Any::Chain5),
            6 => chain!(Any::Chain6),
            count => {
                let text = format!("a chain has 1 to 6 joints, got {count}");
                return Err(PyValueError::new_err(text));
            }
        }))
    }

    #[getter]
    fn n_joints(&self) -> usize {
        each!(&self.0, config => config.joints.len())
    }

    #[getter]
    fn parameter_names(&self) -> Vec<(&'static str, Option<usize>)> {
        each!(&self.0, config => config.parameter_names())
    }

    #[pyo3(signature = (parameters, voltage, *, motor_angle, step, steps_per_tick, steps_per_sample,
        samples, record, reference=None, servo=None, steps_per_servo=1, motor_velocity=None,
        link_angle=None, link_velocity=None, initial_voltage=None))]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        parameters: Matrix<'py>,
        voltage: Matrix<'py>,
        motor_angle: Vec<f64>,
        step: f64,
        steps_per_tick: usize,
        steps_per_sample: usize,
        samples: usize,
        record: Vec<String>,
        reference: Option<Matrix<'py>>,
        servo: Option<ServoGiven>,
        steps_per_servo: usize,
        motor_velocity: Option<Vec<f64>>,
        link_angle: Option<Vec<f64>>,
        link_velocity: Option<Vec<f64>>,
        initial_voltage: Option<Vec<f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let clock = Clock {
            step,
            steps_per_tick,
            steps_per_servo,
            steps_per_sample,
            samples,
        };
        check_clock(&clock)?;
        let experiment = Experiment {
            voltage,
            reference,
            servo,
            clock,
            motor_angle,
            motor_velocity,
            link_angle,
            link_velocity,
            initial_voltage,
            record: quantities(&record)?,
        };
        let columns = each!(&self.0, config => run(py, config, &parameters, &experiment))?;
        let shape = [parameters.as_array().nrows(), samples, self.n_joints()];
        let result = PyDict::new(py);
        for (name, column) in record.iter().zip(columns) {
            let array: Bound<'py, PyArray3<f64>> = PyArray1::from_vec(py, column).reshape(shape)?;
            result.set_item(name, array)?;
        }
        Ok(result)
    }

    #[pyo3(signature = (parameters, voltage, *, with_respect_to, motor_angle, step, steps_per_tick,
        steps_per_sample, samples, record, reference=None, servo=None, steps_per_servo=1,
        motor_velocity=None, link_angle=None, link_velocity=None, initial_voltage=None, taps=None,
        samples_per_row=1))]
    fn sensitivities<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        voltage: Matrix<'py>,
        with_respect_to: Vec<Direction>,
        motor_angle: Vec<f64>,
        step: f64,
        steps_per_tick: usize,
        steps_per_sample: usize,
        samples: usize,
        record: Vec<String>,
        reference: Option<Matrix<'py>>,
        servo: Option<ServoGiven>,
        steps_per_servo: usize,
        motor_velocity: Option<Vec<f64>>,
        link_angle: Option<Vec<f64>>,
        link_velocity: Option<Vec<f64>>,
        initial_voltage: Option<Vec<f64>>,
        taps: Option<Vec<Vec<f64>>>,
        samples_per_row: usize,
    ) -> PyResult<Bound<'py, PyDict>> {
        let clock = Clock {
            step,
            steps_per_tick,
            steps_per_servo,
            steps_per_sample,
            samples,
        };
        check_clock(&clock)?;
        let experiment = Experiment {
            voltage,
            reference,
            servo,
            clock,
            motor_angle,
            motor_velocity,
            link_angle,
            link_velocity,
            initial_voltage,
            record: quantities(&record)?,
        };
        let decimation = match taps {
            None => None,
            Some(taps) if taps.len() == experiment.record.len() => {
                let found = Decimation::new(taps, samples_per_row);
                Some(found.ok_or_else(|| PyValueError::new_err(TAPS))?)
            }
            Some(_) => return Err(PyValueError::new_err(TAPS)),
        };
        let columns = each!(&self.0, config => follow(
            py, config, &parameters, &with_respect_to, &experiment, decimation.as_ref(),
        ))?;
        let result = PyDict::new(py);
        for (name, column) in record.iter().zip(columns) {
            result.set_item(name, column)?;
        }
        Ok(result)
    }

    fn base_regressor<'py>(
        &self,
        py: Python<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        each!(&self.0, config => base_regressor(py, config, [&angle, &velocity, &acceleration]))
    }

    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
        acceleration: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let motion = [&angle, &velocity, &acceleration];
        each!(&self.0, config => inverse_dynamics(py, config, &parameters, motion))
    }

    fn inertia_matrix<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        angle: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        each!(&self.0, config => inertia_matrix(py, config, &parameters, &angle))
    }

    fn bias_torques<'py>(
        &self,
        py: Python<'py>,
        parameters: Vector<'py>,
        angle: Matrix<'py>,
        velocity: Matrix<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let motion = [&angle, &velocity, &velocity];
        each!(&self.0, config => bias_torques(py, config, &parameters, motion))
    }
}

fn configure<A: arm::Arm<N>, const N: usize>(
    arm: A,
    (corner, joints): &(f64, Vec<JointConfig>),
) -> PyResult<Box<Config<A, N>>> {
    if *corner <= 0.0 || corner.is_nan() {
        return Err(PyValueError::new_err("gear_corner must be positive"));
    }
    Ok(Box::new(Config {
        arm,
        corner: *corner,
        joints: of_joints(joints)?,
    }))
}

impl Experiment<'_> {
    fn task<A: arm::Arm<N>, const N: usize>(&self, config: &Config<A, N>) -> PyResult<Task<A, N>> {
        Ok(Task {
            config: *config,
            clock: self.clock,
            servo: self.servo.as_ref().map(|own| self.servo(own)).transpose()?,
            record: self.record.clone(),
        })
    }

    fn servo<const N: usize>(
        &self,
        (kp, ki, limit, active, position_gain): &ServoGiven,
    ) -> PyResult<Servo<N>> {
        let velocity = PiVelocity {
            kp: fixed(kp, "kp")?,
            ki: fixed(ki, "ki")?,
            limit: *limit,
            period: self.clock.step * self.clock.steps_per_servo as f64,
            active: fixed(active, "active")?,
        };
        Ok(match position_gain {
            None => Servo::PiVelocity(velocity),
            Some(gain) => Servo::PiPosition(PiPosition {
                velocity,
                position_gain: fixed(gain, "position_gain")?,
            }),
        })
    }

    fn initial<const N: usize>(&self) -> PyResult<Initial<N>> {
        let or_zero = |values: &Option<Vec<f64>>, name| match values {
            Some(values) => fixed(values, name),
            None => Ok([0.0; N]),
        };
        Ok(Initial {
            motor_angle: fixed(&self.motor_angle, "motor_angle")?,
            motor_velocity: or_zero(&self.motor_velocity, "motor_velocity")?,
            link_angle: match &self.link_angle {
                Some(angle) => Some(fixed(angle, "link_angle")?),
                None => None,
            },
            link_velocity: or_zero(&self.link_velocity, "link_velocity")?,
            voltage: or_zero(&self.initial_voltage, "initial_voltage")?,
        })
    }

    /// Voltage and reference, a row a tick.
    fn inputs<const N: usize>(&self) -> PyResult<[Vec<[f64; N]>; 2]> {
        let ticks = self.clock.ticks();
        let reference = match &self.reference {
            Some(reference) => rows::<N>(reference, "reference", ticks)?,
            None => vec![[0.0; N]; ticks],
        };
        Ok([rows::<N>(&self.voltage, "voltage", ticks)?, reference])
    }
}

fn run<A: arm::Arm<N>, const N: usize>(
    py: Python<'_>,
    config: &Config<A, N>,
    parameters: &Matrix<'_>,
    experiment: &Experiment<'_>,
) -> PyResult<Vec<Vec<f64>>> {
    let values = checked_parameters(config, parameters)?;
    let task = experiment.task(config)?;
    let [feed_forward, reference] = &experiment.inputs::<N>()?;
    let initial = experiment.initial()?;
    let members: Vec<Member<'_, N>> = values
        .iter()
        .map(|parameters| Member {
            parameters,
            feed_forward,
            reference,
            initial,
        })
        .collect();
    let results = py.detach(|| dispatch::simulate(&task, &members, Width::detect()));
    let records: Vec<Record<N>> = results
        .into_iter()
        .map(|result| result.map_err(divergence))
        .collect::<PyResult<_>>()?;
    Ok((0..task.record.len())
        .map(|k| {
            records
                .iter()
                .flat_map(|record| record[k].as_flattened().to_vec())
                .collect()
        })
        .collect())
}

fn follow<'py, A: arm::Arm<N>, const N: usize>(
    py: Python<'py>,
    config: &Config<A, N>,
    parameters: &Vector<'_>,
    with_respect_to: &[Direction],
    experiment: &Experiment<'_>,
    decimation: Option<&Decimation>,
) -> PyResult<Vec<WithTangents<'py>>> {
    let values = parameters.as_array().to_vec();
    check_values(config, &values)?;
    let directions = with_respect_to
        .iter()
        .map(|direction| source(config, direction))
        .collect::<PyResult<Vec<Source>>>()?;
    let task = experiment.task(config)?;
    let [feed_forward, reference] = &experiment.inputs::<N>()?;
    let member = Member {
        parameters: &values,
        feed_forward,
        reference,
        initial: experiment.initial()?,
    };
    let Sensitivities { values, tangents } = py
        .detach(|| {
            dispatch::sensitivities(&task, &member, &directions, decimation, Width::detect())
        })
        .map_err(divergence)?;
    let samples = decimation.map_or(task.clock.samples, |all| all.rows(task.clock.samples));
    values
        .into_iter()
        .zip(tangents)
        .map(|(values, tangents)| {
            let values = PyArray1::from_vec(py, values.into_flattened());
            let tangents = PyArray1::from_vec(py, tangents);
            Ok((
                values.reshape([samples, N])?,
                tangents.reshape([samples, N, directions.len()])?,
            ))
        })
        .collect()
}

/// What a direction's name stands for.
fn source<A: arm::Arm<N>, const N: usize>(
    config: &Config<A, N>,
    (name, joint): &Direction,
) -> PyResult<Source> {
    let names = config.parameter_names();
    let parameter = names
        .iter()
        .position(|known| (known.0, known.1) == (name.as_str(), *joint));
    let initial: Option<fn(usize) -> Source> = match name.as_str() {
        "initial_motor_angle" => Some(Source::MotorAngle),
        "initial_motor_velocity" => Some(Source::MotorVelocity),
        "initial_link_angle" => Some(Source::LinkAngle),
        "initial_link_velocity" => Some(Source::LinkVelocity),
        _ => None,
    };
    match (parameter, initial, joint) {
        (Some(k), _, _) => Ok(Source::Parameter(k)),
        (_, Some(state), Some(joint)) if (1..=N).contains(joint) => Ok(state(joint - 1)),
        _ => Err(PyValueError::new_err(format!(
            "this arm has no {name:?} of joint {joint:?} to differentiate by"
        ))),
    }
}

fn divergence(diverged: Diverged) -> PyErr {
    PyFloatingPointError::new_err(format!("the motion diverged at {} s", diverged.time))
}

fn base_regressor<'py, A: arm::Arm<N>, const N: usize>(
    py: Python<'py>,
    config: &Config<A, N>,
    motion: [&Matrix<'py>; 3],
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let [q, dq, ddq] = same_rows::<N>(motion)?;
    let bases = config.arm.names().len();
    let mut all = vec![0.0; q.len() * N * bases];
    py.detach(|| {
        for (k, row) in all.chunks_mut(N * bases).enumerate() {
            for (b, torque) in rigid::base_regressor(&config.arm, &q[k], &dq[k], &ddq[k])
                .iter()
                .enumerate()
            {
                for i in 0..N {
                    row[i * bases + b] = torque[i];
                }
            }
        }
    });
    PyArray1::from_vec(py, all).reshape([q.len(), N, bases])
}

fn inverse_dynamics<'py, A: arm::Arm<N>, const N: usize>(
    py: Python<'py>,
    config: &Config<A, N>,
    parameters: &Vector<'py>,
    motion: [&Matrix<'py>; 3],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values = parameters.as_array().to_vec();
    check_values(config, &values)?;
    let [q, dq, ddq] = same_rows::<N>(motion)?;
    let all = py.detach(|| {
        let plant = config.plant(&[&values]);
        (0..q.len())
            .flat_map(|k| rigid::inverse_dynamics(&plant, &q[k], &dq[k], &ddq[k]))
            .collect::<Vec<f64>>()
    });
    PyArray1::from_vec(py, all).reshape([q.len(), N])
}

fn inertia_matrix<'py, A: arm::Arm<N>, const N: usize>(
    py: Python<'py>,
    config: &Config<A, N>,
    parameters: &Vector<'py>,
    angle: &Matrix<'py>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values = parameters.as_array().to_vec();
    check_values(config, &values)?;
    let q = rows::<N>(angle, "angle", 0)?;
    let all: Vec<f64> = py.detach(|| {
        let base = config.arm.base(&values);
        let at = |q| config.arm.inertia(&base, &config.arm.posture(q));
        q.iter()
            .flat_map(|q| at(q).as_flattened().to_vec())
            .collect()
    });
    PyArray1::from_vec(py, all).reshape([q.len(), N, N])
}

fn bias_torques<'py, A: arm::Arm<N>, const N: usize>(
    py: Python<'py>,
    config: &Config<A, N>,
    parameters: &Vector<'py>,
    motion: [&Matrix<'py>; 3],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values = parameters.as_array().to_vec();
    check_values(config, &values)?;
    let [q, dq, _] = same_rows::<N>(motion)?;
    let all: Vec<f64> = py.detach(|| {
        let base = config.arm.base(&values);
        let at = |(q, dq): (_, &[f64; N])| config.arm.bias(&base, &config.arm.posture(q), dq);
        q.iter().zip(&dq).flat_map(at).collect()
    });
    PyArray1::from_vec(py, all).reshape([q.len(), N])
}

fn checked_parameters<A: arm::Arm<N>, const N: usize>(
    config: &Config<A, N>,
    parameters: &Matrix<'_>,
) -> PyResult<Vec<Vec<f64>>> {
    let values: Vec<Vec<f64>> = parameters
        .as_array()
        .rows()
        .into_iter()
        .map(|row| row.to_vec())
        .collect();
    if values.is_empty() {
        return Err(PyValueError::new_err(
            "parameters has no rows: expected one for each arm",
        ));
    }
    for own in &values {
        check_values(config, own)?;
    }
    Ok(values)
}

fn check_values<A: arm::Arm<N>, const N: usize>(
    config: &Config<A, N>,
    values: &[f64],
) -> PyResult<()> {
    let expected = config.parameter_names().len();
    if values.len() != expected {
        let got = values.len();
        return Err(PyValueError::new_err(format!(
            "expected {expected} parameters, got {got}"
        )));
    }
    config
        .check(values)
        .map_err(|invalid| PyValueError::new_err(invalid.to_string()))
}
