//! Python class of an experiment.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strainwave_core::actuation::{JointLaw, LawState, MAX_LAW_STATES};
use strainwave_core::arm::link_signals::{self, LINK_SIGNALS, LinkSensor};
use strainwave_core::compiled::{self, ServoGains, ServoLaws, ServoSettings};
use strainwave_core::experiment::{Clock, Quantity};

use crate::arguments::{Matrix, Vector, rows};

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

/// An experiment on arms of one number of joints; see _core.pyi.
#[pyclass(frozen, module = "strainwave._core")]
pub struct Experiment {
    pub core: compiled::Experiment,
    pub joints: usize,
    /// Names of the recorded quantities.
    pub record: Vec<String>,
}

#[pymethods]
impl Experiment {
    #[getter]
    fn clock(&self) -> (f64, usize, usize, usize, usize) {
        let clock = &self.core.clock;
        (
            clock.step,
            clock.steps_per_tick,
            clock.steps_per_servo,
            clock.steps_per_sample,
            clock.samples,
        )
    }
}

impl Experiment {
    /// The experiment on an arm. Raises ValueError for another number of joints.
    pub fn of(&self, joints: usize) -> PyResult<&compiled::Experiment> {
        if self.joints != joints {
            let got = self.joints;
            let text = format!("expected an experiment on {joints} joints, got {got}");
            return Err(PyValueError::new_err(text));
        }
        Ok(&self.core)
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
