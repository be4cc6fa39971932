//! Arms of any number of joints behind one interface: [`CompiledArm`].
//!
//! The number of joints is a constant in the programs of an arm, but not in this interface. Lists
//! of numbers are flat, with a row of joints for each sample or tick.

use std::sync::Arc;

use crate::actuation::{JointLaw, LinearServo, PiPosition, PiVelocity, Servo};
use crate::arm::link_signals::LinkSensor;
use crate::arm::{Arm, Kinematics, Name};
use crate::experiment::{Clock, Diverged, Initial, Member, Quantity, Record, Source, Task};
use crate::plant::config::{Config, InvalidParameter};
use crate::plant::rigid;
use crate::program::{Case, Programs, Width};
use crate::sensitivity::{Request, Variant};
use crate::sensors::decimation::Decimation;

/// One experiment on an arm.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// Clock of steps, ticks and samples.
    pub clock: Clock,
    /// Servo; `None`: each joint gets its feed-forward voltage.
    pub servo: Option<ServoSettings>,
    /// Feed-forward voltage [V], a row per tick.
    pub voltage: Vec<f64>,
    /// Servo reference [rad/s], a row per tick; may be empty without a servo.
    pub reference: Vec<f64>,
    /// Initial state.
    pub initial: InitialState,
    /// Quantities to record.
    pub record: Vec<Quantity>,
    /// Sensors on the links that the record names.
    pub link_sensors: Vec<LinkSensor>,
}

/// Settings of a servo.
#[derive(Clone, Debug)]
pub enum ServoSettings {
    /// Of a PI velocity servo, with or without a position loop.
    Gains(ServoGains),
    /// Of a linear servo.
    Laws(ServoLaws),
}

/// Laws of a linear servo.
#[derive(Clone, Debug)]
pub struct ServoLaws {
    /// One per joint; `None`: the joint is not under servo.
    pub laws: Arc<[Option<JointLaw>]>,
    /// Output limit [V].
    pub limit: f64,
}

/// Gains of a PI velocity servo, one number per joint.
#[derive(Clone, Debug)]
pub struct ServoGains {
    /// kp [V s/rad].
    pub kp: Vec<f64>,
    /// ki [V/rad].
    pub ki: Vec<f64>,
    /// Output limit [V]; integration stops while the output is limited.
    pub limit: f64,
    /// The joints under servo.
    pub active: Vec<bool>,
    /// Gains [1/s] of the outer position loop; `None`: no position loop.
    pub position_gain: Option<Vec<f64>>,
}

/// Initial state of an experiment, one number per joint.
#[derive(Clone, Debug)]
pub struct InitialState {
    /// theta_M [rad].
    pub motor_angle: Vec<f64>,
    /// dtheta_M [rad/s]; `None`: zero.
    pub motor_velocity: Option<Vec<f64>>,
    /// theta_L [rad]; `None`: in equilibrium with gravity.
    pub link_angle: Option<Vec<f64>>,
    /// dtheta_L [rad/s]; `None`: zero.
    pub link_velocity: Option<Vec<f64>>,
    /// Voltage [V] before the start, to which the torque has settled; `None`: zero.
    pub voltage: Option<Vec<f64>>,
}

/// Link angles, velocities and accelerations, a row of joints per sample.
#[derive(Clone, Copy, Debug)]
pub struct LinkMotion<'a> {
    /// q [rad].
    pub angle: &'a [f64],
    /// dq [rad/s].
    pub velocity: &'a [f64],
    /// ddq [rad/s^2].
    pub acceleration: &'a [f64],
}

/// Recorded quantities, each samples times joints.
pub type Recording = Vec<Vec<f64>>;

/// Recorded quantities and their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Derivatives {
    /// As from [`CompiledArm::simulate`], or rows behind a low-pass.
    pub values: Recording,
    /// For each quantity: samples (or rows) times joints times directions.
    pub tangents: Vec<Vec<f64>>,
}

/// A list whose size does not match the arm or the clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrongSize {
    /// Name of the list.
    pub name: &'static str,
    /// Expected size.
    pub expected: usize,
    /// Size of the list.
    pub got: usize,
}

impl std::fmt::Display for WrongSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            name,
            expected,
            got,
        } = self;
        write!(f, "{name}: expected {expected} values, got {got}")
    }
}

impl std::error::Error for WrongSize {}

/// An arm with its known constants and compiled equations.
///
/// Methods with parameters panic if [`CompiledArm::check`] rejects them. Methods with an experiment
/// panic if [`Experiment::check`] rejects it. Methods with a motion panic if it does not consist of
/// whole rows of joints.
pub trait CompiledArm: Send + Sync {
    /// Number of joints.
    fn joints(&self) -> usize;
    /// Number of inertial and gravity parameters, which come first in lists of parameters.
    fn base_parameters(&self) -> usize;
    /// Names of the parameters, in the order of lists of values.
    fn parameter_names(&self) -> Vec<Name>;
    /// Checks a list of parameter values, which must be as long as the list of names.
    ///
    /// # Errors
    /// The first impossible value.
    fn check(&self, parameters: &[f64]) -> Result<(), InvalidParameter>;

    /// Numbers in a register: so many experiments take little longer than one.
    fn lanes(&self) -> usize;
    /// Simulates experiments, each with its parameters. Neighbours with equal clocks and quantities
    /// share registers.
    ///
    /// # Errors
    /// The first motion that diverged.
    fn simulate(&self, cases: &[(&Experiment, &[f64])]) -> Result<Vec<Recording>, Diverged>;
    /// Simulates one experiment with derivatives of all samples, or of rows behind a low-pass.
    ///
    /// # Errors
    /// The motion diverged.
    fn sensitivities(
        &self,
        experiment: &Experiment,
        parameters: &[f64],
        directions: &[Source],
        variants: &[Variant<'_>],
        decimation: Option<&Decimation>,
    ) -> Result<Derivatives, Diverged>;

    /// Motion of the links.
    fn kinematics(&self) -> &Kinematics;
    /// Link-side torques [N m] per base parameter: samples times joints times base parameters.
    fn base_regressor(&self, motion: &LinkMotion<'_>) -> Vec<f64>;
    /// Motor torques [N m] behind rigid gears per combination of base parameters: samples times
    /// motors times combinations.
    ///
    /// `combinations` are base parameters times combinations, and `transmission` link angles per
    /// motor angle, joints times motors.
    fn motor_regressor(
        &self,
        motion: &LinkMotion<'_>,
        combinations: &[f64],
        transmission: &[f64],
    ) -> Vec<f64>;
    /// Link-side torques [N m] for base parameters, physical or not: samples times joints.
    fn link_torques(&self, base: &[f64], motion: &LinkMotion<'_>) -> Vec<f64>;
    /// Motor torques [N m] of a motion with rigid gears, (5): samples times joints.
    fn inverse_dynamics(&self, parameters: &[f64], motion: &LinkMotion<'_>) -> Vec<f64>;
    /// M_L(q) of (2) [kg m^2] for base parameters, physical or not: samples times joints times joints.
    fn inertia_matrix(&self, base: &[f64], angle: &[f64]) -> Vec<f64>;
    /// Centrifugal, Coriolis and gravity torques c + g of (2) [N m]: samples times joints.
    fn bias_torques(&self, parameters: &[f64], angle: &[f64], velocity: &[f64]) -> Vec<f64>;
}

impl Experiment {
    /// Checks the sizes of all lists against the number of joints.
    ///
    /// # Errors
    /// The first list of a wrong size.
    pub fn check(&self, joints: usize) -> Result<(), WrongSize> {
        let of_ticks = self.clock.ticks() * joints;
        let exact = |name, got| match got {
            got if got == joints => Ok(()),
            got => Err(WrongSize {
                name,
                expected: joints,
                got,
            }),
        };
        let optional = |name, list: &Option<Vec<f64>>| match list {
            Some(list) => exact(name, list.len()),
            None => Ok(()),
        };
        let at_least = |name, got| match got {
            got if got >= of_ticks => Ok(()),
            got => Err(WrongSize {
                name,
                expected: of_ticks,
                got,
            }),
        };
        at_least("voltage", self.voltage.len())?;
        if let Some(servo) = &self.servo {
            at_least("reference", self.reference.len())?;
            match servo {
                ServoSettings::Gains(gains) => {
                    exact("kp", gains.kp.len())?;
                    exact("ki", gains.ki.len())?;
                    exact("active", gains.active.len())?;
                    optional("position_gain", &gains.position_gain)?;
                }
                ServoSettings::Laws(servo) => exact("laws", servo.laws.len())?,
            }
        }
        for sensor in &self.link_sensors {
            exact("link_sensors", sensor.weights.len())?;
        }
        exact("motor_angle", self.initial.motor_angle.len())?;
        optional("motor_velocity", &self.initial.motor_velocity)?;
        optional("link_angle", &self.initial.link_angle)?;
        optional("link_velocity", &self.initial.link_velocity)?;
        optional("initial_voltage", &self.initial.voltage)
    }

    fn task<A: Arm<N>, const N: usize>(&self, config: &Config<A, N>) -> Task<A, N> {
        Task {
            config: *config,
            clock: self.clock,
            servo: self.servo.as_ref().map(|servo| servo.servo(&self.clock)),
            record: self.record.clone(),
            link_sensors: self.link_sensors.clone(),
        }
    }

    /// Voltages and references, row by row.
    fn inputs<const N: usize>(&self, joints: usize) -> [Vec<[f64; N]>; 2] {
        [&self.voltage, &self.reference].map(|list| rows(list, joints))
    }

    /// The parameters, voltages, references and initial state.
    fn member<'a, const N: usize>(
        &self,
        parameters: &'a [f64],
        [feed_forward, reference]: &'a [Vec<[f64; N]>; 2],
    ) -> Member<'a, N> {
        let initial = &self.initial;
        let or_zero = |list: &Option<Vec<f64>>| list.as_deref().map_or([0.0; N], row);
        Member {
            parameters,
            feed_forward,
            reference,
            initial: Initial {
                motor_angle: row(&initial.motor_angle),
                motor_velocity: or_zero(&initial.motor_velocity),
                link_angle: initial.link_angle.as_deref().map(row),
                link_velocity: or_zero(&initial.link_velocity),
                voltage: or_zero(&initial.voltage),
            },
        }
    }
}

impl ServoSettings {
    fn servo<const N: usize>(&self, clock: &Clock) -> Servo<N> {
        let period = clock.step * clock.steps_per_servo as f64;
        match self {
            Self::Gains(gains) => gains.servo(period),
            Self::Laws(servo) => Servo::LinearServo(LinearServo {
                laws: Arc::clone(&servo.laws),
                limit: servo.limit,
                period,
            }),
        }
    }
}

impl ServoGains {
    fn servo<const N: usize>(&self, period: f64) -> Servo<N> {
        let velocity = PiVelocity {
            kp: row(&self.kp),
            ki: row(&self.ki),
            limit: self.limit,
            period,
            active: row(&self.active),
        };
        match &self.position_gain {
            None => Servo::PiVelocity(velocity),
            Some(gain) => Servo::PiPosition(PiPosition {
                velocity,
                position_gain: row(gain),
            }),
        }
    }
}

/// One row of joints, with zeros beyond the arm's joints.
fn row<T: Copy + Default, const N: usize>(list: &[T]) -> [T; N] {
    let mut all = [T::default(); N];
    all[..list.len()].copy_from_slice(list);
    all
}

/// Whole rows of joints.
fn rows<const N: usize>(list: &[f64], joints: usize) -> Vec<[f64; N]> {
    list.chunks_exact(joints).map(row).collect()
}

/// Numbers of the joints for each of `count` rows.
fn each_row<const N: usize>(
    count: usize,
    joints: usize,
    of: impl Fn(usize) -> [f64; N],
) -> Vec<f64> {
    let mut all = vec![0.0; count * joints];
    for (k, row) in all.chunks_exact_mut(joints).enumerate() {
        row.copy_from_slice(&of(k)[..joints]);
    }
    all
}

/// A recording without the entries beyond the arm's joints.
fn recording<const N: usize>(record: &Record<N>, joints: usize) -> Recording {
    let flat = |rows: &Vec<[f64; N]>| {
        rows.iter()
            .flat_map(|row| &row[..joints])
            .copied()
            .collect()
    };
    record.iter().map(flat).collect()
}

/// An arm, its constants and its programs.
struct Compiled<A: 'static, const N: usize> {
    config: Config<A, N>,
    kinematics: Kinematics,
    programs: Programs<A, N>,
    width: Width,
}

/// An arm behind the common interface, on registers of a given width.
///
/// # Panics
/// The processor has no registers of that width.
pub fn compiled<A: Arm<N>, const N: usize>(
    config: Config<A, N>,
    programs: Programs<A, N>,
    width: Width,
) -> Box<dyn CompiledArm> {
    width.require();
    Box::new(Compiled {
        config,
        kinematics: config.arm.chain().into(),
        programs,
        width,
    })
}

impl<A: Arm<N>, const N: usize> CompiledArm for Compiled<A, N> {
    fn joints(&self) -> usize {
        self.config.arm.joints()
    }

    fn base_parameters(&self) -> usize {
        self.config.arm.names().len()
    }

    fn parameter_names(&self) -> Vec<Name> {
        self.config.parameter_names()
    }

    fn check(&self, parameters: &[f64]) -> Result<(), InvalidParameter> {
        self.config.check(parameters)
    }

    fn lanes(&self) -> usize {
        self.width.lanes()
    }

    fn simulate(&self, cases: &[(&Experiment, &[f64])]) -> Result<Vec<Recording>, Diverged> {
        let inputs = cases.iter().map(|(one, _)| one.inputs(self.joints()));
        let inputs: Vec<_> = inputs.collect();
        let case = |((experiment, parameters), inputs)| -> Case<'_, A, N> {
            let (experiment, parameters): (&Experiment, &[f64]) = (experiment, parameters);
            (
                experiment.task(&self.config),
                experiment.member(parameters, inputs),
            )
        };
        let all: Vec<_> = cases.iter().copied().zip(&inputs).map(case).collect();
        let records = self.programs.simulate_all(&all, self.width).into_iter();
        records
            .map(|record| Ok(recording(&record?, self.joints())))
            .collect()
    }

    fn sensitivities(
        &self,
        experiment: &Experiment,
        parameters: &[f64],
        directions: &[Source],
        variants: &[Variant<'_>],
        decimation: Option<&Decimation>,
    ) -> Result<Derivatives, Diverged> {
        let inputs = experiment.inputs(self.joints());
        let request = Request {
            task: &experiment.task(&self.config),
            member: &experiment.member(parameters, &inputs),
            directions,
            variants,
            decimation,
        };
        let sensitivities = self.programs.differentiate(&request, self.width)?;
        Ok(Derivatives {
            values: recording(&sensitivities.values, self.joints()),
            tangents: sensitivities.tangents,
        })
    }

    fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    fn base_regressor(&self, motion: &LinkMotion<'_>) -> Vec<f64> {
        let (bases, n) = (self.base_parameters(), self.joints());
        let [q, dq, ddq] = motion.rows::<N>(n);
        let mut all = vec![0.0; q.len() * n * bases];
        for (k, row) in all.chunks_mut(n * bases).enumerate() {
            let at = self.config.arm.posture(&q[k]);
            let columns = self.config.arm.regressor(&at, &dq[k], &ddq[k]);
            for (b, torque) in columns.as_ref().iter().enumerate() {
                for i in 0..n {
                    row[i * bases + b] = torque[i];
                }
            }
        }
        all
    }

    fn motor_regressor(
        &self,
        motion: &LinkMotion<'_>,
        combinations: &[f64],
        transmission: &[f64],
    ) -> Vec<f64> {
        let n = self.joints();
        let count = combinations.len() / self.base_parameters();
        // most entries are zero: base parameter, joint, place in a sample's regressor, factor
        let mut terms = Vec::new();
        for (b, combination) in combinations.chunks(count.max(1)).enumerate() {
            for (place, ratio) in transmission.iter().enumerate() {
                for (column, weight) in combination.iter().enumerate() {
                    let factor = ratio * weight;
                    if factor != 0.0 {
                        terms.push((b, place / n, place % n * count + column, factor));
                    }
                }
            }
        }
        let [q, dq, ddq] = motion.rows::<N>(n);
        let mut all = vec![0.0; q.len() * n * count];
        for (k, row) in all.chunks_mut((n * count).max(1)).enumerate() {
            let at = self.config.arm.posture(&q[k]);
            let columns = self.config.arm.regressor(&at, &dq[k], &ddq[k]);
            let torques = columns.as_ref();
            for &(b, joint, place, factor) in &terms {
                row[place] += factor * torques[b][joint];
            }
        }
        all
    }

    fn link_torques(&self, base: &[f64], motion: &LinkMotion<'_>) -> Vec<f64> {
        let (arm, n) = (&self.config.arm, self.joints());
        let base = arm.base(base);
        let [q, dq, ddq] = motion.rows::<N>(n);
        each_row(q.len(), n, |k| {
            arm.torques(&base, &arm.posture(&q[k]), &dq[k], &ddq[k])
        })
    }

    fn inverse_dynamics(&self, parameters: &[f64], motion: &LinkMotion<'_>) -> Vec<f64> {
        let (plant, n) = (self.config.plant(parameters), self.joints());
        let [q, dq, ddq] = motion.rows::<N>(n);
        each_row(q.len(), n, |k| {
            rigid::inverse_dynamics(&plant, &q[k], &dq[k], &ddq[k])
        })
    }

    fn inertia_matrix(&self, base: &[f64], angle: &[f64]) -> Vec<f64> {
        let (arm, n) = (&self.config.arm, self.joints());
        let base = arm.base(base);
        let mut all = vec![0.0; angle.len() * n];
        for (matrix, q) in all.chunks_mut(n * n).zip(rows::<N>(angle, n)) {
            let inertia = arm.inertia(&base, &arm.posture(&q));
            for (row, entries) in matrix.chunks_mut(n).zip(inertia) {
                row.copy_from_slice(&entries[..n]);
            }
        }
        all
    }

    fn bias_torques(&self, parameters: &[f64], angle: &[f64], velocity: &[f64]) -> Vec<f64> {
        let (arm, n) = (&self.config.arm, self.joints());
        let base = arm.base(parameters);
        let (q, dq) = (rows(angle, n), rows(velocity, n));
        each_row(q.len(), n, |k| arm.bias(&base, &arm.posture(&q[k]), &dq[k]))
    }
}

impl LinkMotion<'_> {
    fn rows<const N: usize>(&self, joints: usize) -> [Vec<[f64; N]>; 3] {
        [self.angle, self.velocity, self.acceleration].map(|list| rows(list, joints))
    }
}
