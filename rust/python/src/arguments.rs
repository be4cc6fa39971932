//! Conversion and checks of arguments from Python.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_core::actuation::{JointLaw, LawState, MAX_LAW_STATES};
use strainwave_core::arm::link_signals::{self, LINK_SIGNALS, LinkSensor};
use strainwave_core::arm::{ChainJoint, JointType};
use strainwave_core::compiled::{ServoGains, ServoLaws, ServoSettings};
use strainwave_core::experiment::{Clock, Quantity};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::{self, Law};
use strainwave_core::plant::config::JointConfig;

pub type Matrix<'py> = PyReadonlyArray2<'py, f64>;
pub type Vector<'py> = PyReadonlyArray1<'py, f64>;
/// A, B, C, D and E of a law, the states that hold, and the states at rest.
type LawArguments<'py> = (
    Matrix<'py>,
    Matrix<'py>,
    Vector<'py>,
    [f64; 3],
    Vector<'py>,
    Vec<bool>,
    Matrix<'py>,
);
/// A sensor on each link: its name in the record, whether it is a gyro, and a row of weights of the
/// links' signals per joint.
pub type LinkSensorArguments<'py> = (String, bool, Matrix<'py>);
/// A joint of a chain: type; position; roll, pitch and yaw; axis.
pub type JointPlacement = (String, [f64; 3], [f64; 3], [f64; 3]);
/// An optional number for each joint.
type PerJoint = Option<Vec<Option<f64>>>;

/// Known constants of an arm's joints, as lists.
pub struct Joints {
    pub springs: Vec<String>,
    pub gear_ratio: Vec<f64>,
    pub torque_per_volt: Option<Vec<f64>>,
    pub current_loop_hz: PerJoint,
    pub encoder_counts: PerJoint,
    pub accelerometer_hz: PerJoint,
    pub gyro_hz: PerJoint,
    pub imu_accelerometer_hz: PerJoint,
    pub imu_gyro_hz: PerJoint,
    pub effects: Option<Vec<Vec<String>>>,
}

impl Joints {
    /// Constants joint by joint.
    pub fn configs(self) -> PyResult<Vec<JointConfig>> {
        let count = self.springs.len();
        let ratio = per_joint(Some(self.gear_ratio), 1.0, count, "gear_ratio")?;
        let torque_per_volt = per_joint(self.torque_per_volt, 1.0, count, "torque_per_volt")?;
        let each = |values: PerJoint, name| per_joint(values, None, count, name);
        let current_loop_hz = each(self.current_loop_hz, "current_loop_hz")?;
        let encoder_counts = each(self.encoder_counts, "encoder_counts")?;
        let accelerometer_hz = each(self.accelerometer_hz, "accelerometer_hz")?;
        let gyro_hz = each(self.gyro_hz, "gyro_hz")?;
        let imu_accelerometer_hz = each(self.imu_accelerometer_hz, "imu_accelerometer_hz")?;
        let imu_gyro_hz = each(self.imu_gyro_hz, "imu_gyro_hz")?;
        let effects = per_joint(self.effects, Vec::new(), count, "effects")?;
        let joint = |i: usize| {
            let gear = gear_law(&self.springs[i])?;
            Ok(JointConfig {
                gear,
                ratio: ratio[i],
                torque_per_volt: torque_per_volt[i],
                current_loop_hz: current_loop_hz[i],
                encoder_counts: encoder_counts[i],
                accelerometer_hz: accelerometer_hz[i],
                gyro_hz: gyro_hz[i],
                imu_accelerometer_hz: imu_accelerometer_hz[i],
                imu_gyro_hz: imu_gyro_hz[i],
                effects: effect_kinds(&effects[i], gear)?,
            })
        };
        (0..count).map(joint).collect()
    }
}

/// Joints of a chain, with the distances of their accelerometers.
pub fn chain_joints(joints: &[JointPlacement], distances: &[f64]) -> PyResult<Vec<ChainJoint>> {
    let placed = |((name, position, attitude, axis), &distance): (&JointPlacement, &f64)| {
        Ok(ChainJoint {
            joint_type: joint_type(name)?,
            position: *position,
            attitude: *attitude,
            axis: *axis,
            accelerometer_distance: distance,
        })
    };
    joints.iter().zip(distances).map(placed).collect()
}

fn joint_type(name: &str) -> PyResult<JointType> {
    match name {
        "revolute" => Ok(JointType::Revolute),
        "prismatic" => Ok(JointType::Prismatic),
        _ => Err(PyValueError::new_err(format!("no joint of type {name:?}"))),
    }
}

/// A servo.
#[derive(FromPyObject)]
pub enum ServoArguments<'py> {
    /// kp, ki, limit, joints under servo, and the optional gains of the position loop.
    Gains(Vec<f64>, Vec<f64>, f64, Vec<bool>, Option<Vec<f64>>),
    /// A law per joint under servo, and the limit.
    Laws(Vec<Option<LawArguments<'py>>>, f64),
}

impl ServoArguments<'_> {
    pub fn settings(self) -> PyResult<ServoSettings> {
        Ok(match self {
            Self::Gains(kp, ki, limit, active, position_gain) => ServoSettings::Gains(ServoGains {
                kp,
                ki,
                limit,
                active,
                position_gain,
            }),
            Self::Laws(laws, limit) => ServoSettings::Laws(ServoLaws {
                laws: laws
                    .iter()
                    .map(|law| law.as_ref().map(joint_law).transpose())
                    .collect::<PyResult<_>>()?,
                limit,
            }),
        })
    }
}

fn joint_law((a, b, c, d, e, holds, rest): &LawArguments<'_>) -> PyResult<JointLaw> {
    let [a, b, rest] = [a, b, rest].map(|matrix| matrix.as_array());
    let [c, e] = [c, e].map(|vector| vector.as_array());
    let n = c.len();
    let fits = a.dim() == (n, n) && b.dim() == (n, 3) && rest.dim() == (n, 2);
    if !fits || e.len() != n || holds.len() != n || n > MAX_LAW_STATES {
        return Err(PyValueError::new_err(format!(
            "expected a law with A (n, n), B (n, 3), C (n,), D (3,), E (n,), holds (n,) and rest \
             (n, 2), n at most {MAX_LAW_STATES}; got A {:?}, B {:?}, C {n}, E {}, holds {} and rest \
             {:?}",
            a.dim(),
            b.dim(),
            e.len(),
            holds.len(),
            rest.dim(),
        )));
    }
    let state = |k: usize| {
        let mut row = [0.0; MAX_LAW_STATES];
        row[..n].copy_from_slice(&a.row(k).to_vec());
        LawState {
            a: row,
            b: std::array::from_fn(|input| b[[k, input]]),
            c: c[k],
            e: e[k],
            holds: holds[k],
            rest: std::array::from_fn(|source| rest[[k, source]]),
        }
    };
    let law = JointLaw::new((0..n).map(state).collect(), *d);
    Ok(law.expect("few states"))
}

pub fn check_clock(clock: &Clock) -> PyResult<()> {
    let positive = clock.step > 0.0 && clock.step.is_finite();
    let counts = [
        clock.steps_per_tick,
        clock.steps_per_servo,
        clock.steps_per_sample,
        clock.samples,
    ];
    if !positive || counts.contains(&0) {
        return Err(PyValueError::new_err(
            "step, samples and the numbers of steps must be positive",
        ));
    }
    Ok(())
}

fn gear_law(name: &str) -> PyResult<Law> {
    gear::law(name).ok_or_else(|| PyValueError::new_err(format!("unknown gear spring {name:?}")))
}

fn effect_kinds(names: &[String], gear: Law) -> PyResult<EffectKinds> {
    let mut kinds = EffectKinds::default();
    for name in names {
        if !kinds.add(name) {
            return Err(PyValueError::new_err(format!("no effect {name:?}")));
        }
    }
    match kinds.of_gear() {
        Some(name) if !gear.elastic => {
            let text = format!("a rigid gear has no {}", name.replace('-', " "));
            Err(PyValueError::new_err(text))
        }
        _ => Ok(kinds),
    }
}

/// Recorded quantities, and the sensors on the links among them: those of `named`, and the signals of
/// links.
pub fn quantities(
    names: &[String],
    named: &[LinkSensorArguments<'_>],
    joints: usize,
) -> PyResult<(Vec<Quantity>, Vec<LinkSensor>)> {
    let mut sensors = Vec::new();
    let mut quantity = |name: &String| {
        let sensor = match link_signals::NAMES.iter().position(|one| one == name) {
            Some(signal) => LinkSensor::of_signal(signal, joints),
            None => match named.iter().find(|sensor| sensor.0 == *name) {
                Some((_, is_gyro, weights)) => link_sensor(*is_gyro, weights, joints)?,
                None => return quantity(name),
            },
        };
        sensors.push(sensor);
        Ok(Quantity::LinkSensor(sensors.len() - 1))
    };
    let quantities = names.iter().map(&mut quantity).collect::<PyResult<_>>()?;
    Ok((quantities, sensors))
}

fn link_sensor(is_gyro: bool, weights: &Matrix<'_>, joints: usize) -> PyResult<LinkSensor> {
    let all = rows(weights, "link_sensors", joints, LINK_SIGNALS)?;
    Ok(LinkSensor {
        is_gyro,
        weights: all.as_chunks().0.to_vec(),
    })
}

fn quantity(name: &str) -> PyResult<Quantity> {
    Ok(match name {
        "voltage" => Quantity::Voltage,
        "motor_torque" => Quantity::MotorTorque,
        "motor_angle" => Quantity::MotorAngle,
        "motor_velocity" => Quantity::MotorVelocity,
        "link_angle" => Quantity::LinkAngle,
        "link_velocity" => Quantity::LinkVelocity,
        "link_acceleration" => Quantity::LinkAcceleration,
        "gear_torque" => Quantity::GearTorque,
        "torsion" => Quantity::Torsion,
        "encoder" => Quantity::Encoder,
        "accelerometer" => Quantity::Accelerometer,
        "gyro" => Quantity::Gyro,
        "sliding" => Quantity::Sliding,
        _ => return Err(PyValueError::new_err(format!("unknown quantity {name:?}"))),
    })
}

pub fn per_joint<T: Clone>(
    values: Option<Vec<T>>,
    default: T,
    count: usize,
    name: &str,
) -> PyResult<Vec<T>> {
    let values = values.unwrap_or_else(|| vec![default; count]);
    if values.len() != count {
        let got = values.len();
        return Err(PyValueError::new_err(format!(
            "{name}: expected {count} values, got {got}"
        )));
    }
    Ok(values)
}

/// Values of a matrix, row by row. Raises ValueError unless it has `columns` columns and at least
/// `least` rows.
pub fn rows(
    matrix: &Matrix<'_>,
    name: &str,
    min_rows: usize,
    columns: usize,
) -> PyResult<Vec<f64>> {
    let matrix = matrix.as_array();
    let (got, got_columns) = matrix.dim();
    if got_columns != columns || got < min_rows {
        return Err(PyValueError::new_err(format!(
            "{name}: expected at least {min_rows} x {columns} values, got {got} x {got_columns}"
        )));
    }
    Ok(matrix.iter().copied().collect())
}

/// Rows of angles, velocities and accelerations of a motion. Raises ValueError unless all have the
/// same length.
pub fn same_rows(motion: [&Matrix<'_>; 3], columns: usize) -> PyResult<[Vec<f64>; 3]> {
    let samples = motion[0].as_array().nrows();
    if motion.iter().any(|part| part.as_array().nrows() != samples) {
        return Err(PyValueError::new_err(
            "angle, velocity and acceleration differ in length",
        ));
    }
    let [q, dq, ddq] = motion;
    Ok([
        rows(q, "angle", 0, columns)?,
        rows(dq, "velocity", 0, columns)?,
        rows(ddq, "acceleration", 0, columns)?,
    ])
}

/// Converts an error of the core to ValueError.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
