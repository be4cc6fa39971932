//! Conversion and checks of arguments: constants of an arm, and arrays.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_core::arm::{ChainJoint, JointType};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::{self, Law};
use strainwave_core::plant::config::JointConfig;

pub type Matrix<'py> = PyReadonlyArray2<'py, f64>;
pub type Vector<'py> = PyReadonlyArray1<'py, f64>;
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
    let (got, got_columns) = matrix.as_array().dim();
    if got_columns != columns || got < min_rows {
        return Err(PyValueError::new_err(format!(
            "{name}: expected at least {min_rows} x {columns} values, got {got} x {got_columns}"
        )));
    }
    Ok(match matrix.as_slice() {
        Ok(slice) => slice.to_vec(),
        Err(_) => matrix.as_array().iter().copied().collect(),
    })
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
