//! Experiments: their settings and the quantities that they record.

pub mod known_length;
pub mod simulate;
mod start;
pub mod together;

use crate::actuation::Servo;
use crate::arm::link_signals::LinkSensor;
use crate::plant::config::Config;
use crate::scalar::Real;

/// Quantities that can be recorded, one value per joint each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// u [V], applied from this instant on.
    Voltage,
    /// Motor torque [N m].
    MotorTorque,
    /// theta_M [rad].
    MotorAngle,
    /// dtheta_M [rad/s].
    MotorVelocity,
    /// theta_L [rad].
    LinkAngle,
    /// dtheta_L [rad/s].
    LinkVelocity,
    /// ddtheta_L [rad/s^2].
    LinkAcceleration,
    /// Torque [N m] of each gear at its link; zero for a rigid gear.
    GearTorque,
    /// Torsion C n theta_M - theta_L [rad] of each gear at its link, without kinematic error and base
    /// rotation; zero for a rigid gear.
    Torsion,
    /// Encoder reading [rad].
    Encoder,
    /// Accelerometer reading [m/s^2], behind its low-pass.
    Accelerometer,
    /// Gyro reading [rad/s], behind its low-pass.
    Gyro,
    /// Reading of a sensor in [`Task::link_sensors`] on each link, behind the low-pass of the IMU's
    /// accelerometers or gyros.
    LinkSensor(usize),
    /// 0 while friction holds the motor, else the sign of its velocity.
    Sliding,
}

/// Clock of an experiment. All its events are at multiples of the integrator's step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Step of the integrator [s].
    pub step: f64,
    /// Steps per tick of the feed-forward voltage.
    pub steps_per_tick: usize,
    /// Steps per servo reading.
    pub steps_per_servo: usize,
    /// Steps per recorded sample.
    pub steps_per_sample: usize,
    /// Number of samples; the first one is at time zero.
    pub samples: usize,
}

impl Clock {
    /// Number of steps from the first sample to the last.
    pub fn steps(&self) -> usize {
        self.samples.saturating_sub(1) * self.steps_per_sample
    }

    /// Number of ticks that feed-forward and reference must have.
    pub fn ticks(&self) -> usize {
        self.steps() / self.steps_per_tick + 1
    }

    /// All instants with their events.
    pub(crate) fn instants(&self) -> Instants {
        Instants {
            clock: *self,
            step: 0,
            to_tick: 0,
            to_servo: 0,
            to_sample: 0,
        }
    }
}

/// A running clock. It counts down, because a division at every step costs more.
pub(crate) struct Instants {
    clock: Clock,
    step: usize,
    to_tick: usize,
    to_servo: usize,
    to_sample: usize,
}

impl Iterator for Instants {
    type Item = (usize, Event);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, Event)> {
        let (step, steps) = (self.step, self.clock.steps());
        if step > steps {
            return None;
        }
        let event = Event {
            commands: self.to_tick == 0 || self.to_servo == 0,
            servo_reads: self.to_servo == 0,
            samples: self.to_sample == 0,
            last: step == steps,
        };
        let next = |count: usize, period: usize| if count == 0 { period - 1 } else { count - 1 };
        self.to_tick = next(self.to_tick, self.clock.steps_per_tick);
        self.to_servo = next(self.to_servo, self.clock.steps_per_servo);
        self.to_sample = next(self.to_sample, self.clock.steps_per_sample);
        self.step += 1;
        Some((step, event))
    }
}

/// Initial state of an experiment.
#[derive(Clone, Copy, Debug)]
pub struct Initial<const N: usize> {
    /// theta_M [rad].
    pub motor_angle: [f64; N],
    /// dtheta_M [rad/s].
    pub motor_velocity: [f64; N],
    /// theta_L [rad]; `None`: in equilibrium with gravity.
    pub link_angle: Option<[f64; N]>,
    /// dtheta_L [rad/s].
    pub link_velocity: [f64; N],
    /// Voltage [V] before the start, to which the torque has settled.
    pub voltage: [f64; N],
}

/// Parameters and inputs of one arm in an experiment.
#[derive(Clone, Copy, Debug)]
pub struct Member<'a, const N: usize> {
    /// Parameter values, in the order of [`Config::parameter_names`].
    pub parameters: &'a [f64],
    /// Feed-forward voltage [V] per tick, added to the servo's output.
    pub feed_forward: &'a [[f64; N]],
    /// Servo reference [rad/s] per tick.
    pub reference: &'a [[f64; N]],
    /// Initial state.
    pub initial: Initial<N>,
}

/// An experiment without the parameters of the arm.
#[derive(Clone, Debug)]
pub struct Task<A, const N: usize> {
    /// Known constants of the arm.
    pub config: Config<A, N>,
    /// Clock.
    pub clock: Clock,
    /// Servo; `None`: each joint gets its feed-forward voltage.
    pub servo: Option<Servo<N>>,
    /// Quantities to record.
    pub record: Vec<Quantity>,
    /// Sensors on the links that the record names.
    pub link_sensors: Vec<LinkSensor>,
}

impl<A: Copy, const N: usize> Task<A, N> {
    /// The same experiment with another representation of the arm.
    pub fn with_arm<B>(&self, arm: impl Fn(&A) -> B) -> Task<B, N> {
        Task {
            config: Config {
                arm: arm(&self.config.arm),
                corner: self.config.corner,
                joints: self.config.joints,
            },
            clock: self.clock,
            servo: self.servo.clone(),
            record: self.record.clone(),
            link_sensors: self.link_sensors.clone(),
        }
    }
}

/// A recording: for each quantity of the task, samples times joints.
pub type Record<const N: usize> = RecordOf<f64, N>;

/// A recording over any scalar.
pub type RecordOf<S, const N: usize> = Vec<Vec<[S; N]>>;

/// The values of a recording, without derivatives.
pub fn values<S: Real, const N: usize>(record: &RecordOf<S, N>) -> Record<N> {
    let plain = |row: &[S; N]| row.map(|value| value.lane(0));
    record
        .iter()
        .map(|rows| rows.iter().map(plain).collect())
        .collect()
}

/// A quantity to differentiate with respect to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The parameter with this index in [`Config::parameter_names`].
    Parameter(usize),
    /// Initial motor angle of a joint.
    MotorAngle(usize),
    /// Initial motor velocity of a joint.
    MotorVelocity(usize),
    /// Initial link angle of a joint, or its offset from the equilibrium.
    LinkAngle(usize),
    /// Initial link velocity of a joint.
    LinkVelocity(usize),
    /// None: it fills a block of directions.
    Nothing,
}

/// The motion is no longer finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diverged {
    /// Time [s].
    pub time: f64,
}

/// Events of the clock at one step.
pub(crate) struct Event {
    pub(crate) commands: bool,
    pub(crate) servo_reads: bool,
    pub(crate) samples: bool,
    pub(crate) last: bool,
}
