//! What an experiment is asked, and what it records.

pub mod simulate;
mod start;

use crate::actuation::Servo;
use crate::plant::config::Config;
use crate::scalar::Real;

/// What can be recorded, each a value per joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// u [V], as applied from this instant on.
    Voltage,
    /// Torque of the motor [N m].
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
    /// Torque [N m] each gear passes to its link; zero for a rigid gear.
    GearTorque,
    /// Encoder reading [rad].
    Encoder,
    /// Accelerometer reading [m/s^2], after its bandwidth.
    Accelerometer,
    /// Gyro reading [rad/s], after its bandwidth.
    Gyro,
    /// Specific force [m/s^2] at the link's own axis along the link, after the bandwidth of the
    /// IMU's accelerometers.
    SpecificForceX,
    /// The same across the link.
    SpecificForceY,
    /// Angular acceleration [rad/s^2] of the link in space, after that bandwidth.
    AngularAcceleration,
    /// Square [rad^2/s^2] of its rate in space, after that bandwidth.
    SquaredRate,
    /// Its rate in space [rad/s], after the bandwidth of the IMU's gyros.
    AngularRate,
    /// 0 where the motor stands still by friction, else the sign of its motion.
    Sliding,
}

impl Quantity {
    /// The place among what the sensors of an IMU read combinations of; `None` of all others.
    #[inline(always)]
    pub(crate) fn mounted(self) -> Option<usize> {
        match self {
            Self::SpecificForceX => Some(0),
            Self::SpecificForceY => Some(1),
            Self::AngularAcceleration => Some(2),
            Self::SquaredRate => Some(3),
            Self::AngularRate => Some(4),
            _ => None,
        }
    }
}

/// How time is cut: everything happens at multiples of the integrator's step.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// Step of the integrator [s].
    pub step: f64,
    /// Steps from one voltage of the feed-forward to the next.
    pub steps_per_tick: usize,
    /// Steps from one servo reading to the next.
    pub steps_per_servo: usize,
    /// Steps from one recorded sample to the next.
    pub steps_per_sample: usize,
    /// Samples to record; the first is at time zero.
    pub samples: usize,
}

impl Clock {
    /// Steps from the first sample to the last.
    pub fn steps(&self) -> usize {
        self.samples.saturating_sub(1) * self.steps_per_sample
    }

    /// Ticks the feed-forward and the reference must hold.
    pub fn ticks(&self) -> usize {
        self.steps() / self.steps_per_tick + 1
    }

    /// Every instant, and what is to be done there.
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

/// A clock on its way; it counts down, which is cheaper than to divide at every step.
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
        let next = |left: usize, period: usize| if left == 0 { period - 1 } else { left - 1 };
        self.to_tick = next(self.to_tick, self.clock.steps_per_tick);
        self.to_servo = next(self.to_servo, self.clock.steps_per_servo);
        self.to_sample = next(self.to_sample, self.clock.steps_per_sample);
        self.step += 1;
        Some((step, event))
    }
}

/// How an experiment begins.
#[derive(Clone, Copy, Debug)]
pub struct Initial<const N: usize> {
    /// theta_M [rad].
    pub motor_angle: [f64; N],
    /// dtheta_M [rad/s].
    pub motor_velocity: [f64; N],
    /// theta_L [rad]; `None`: where the links hang at rest on their gears.
    pub link_angle: Option<[f64; N]>,
    /// dtheta_L [rad/s].
    pub link_velocity: [f64; N],
    /// Voltage [V] that has been there long enough for the torque to have followed.
    pub voltage: [f64; N],
}

/// One arm in one experiment.
#[derive(Clone, Copy, Debug)]
pub struct Member<'a, const N: usize> {
    /// Parameter values, in the order of [`Config::parameter_names`].
    pub parameters: &'a [f64],
    /// Voltage [V] per tick, added to the servo's.
    pub feed_forward: &'a [[f64; N]],
    /// Servo reference [rad/s] per tick.
    pub reference: &'a [[f64; N]],
    /// How it begins.
    pub initial: Initial<N>,
}

/// What is common to all arms of a batch.
#[derive(Clone, Debug)]
pub struct Task<A, const N: usize> {
    /// The arm's known constants.
    pub config: Config<A, N>,
    /// How time is cut.
    pub clock: Clock,
    /// The servo; `None`: every joint gets its feed-forward voltage.
    pub servo: Option<Servo<N>>,
    /// What to record.
    pub record: Vec<Quantity>,
}

impl<A: Copy, const N: usize> Task<A, N> {
    /// The same experiment on another description of the arm.
    pub fn with_arm<B>(&self, arm: impl Fn(&A) -> B) -> Task<B, N> {
        Task {
            config: Config {
                arm: arm(&self.config.arm),
                corner: self.config.corner,
                joints: self.config.joints,
            },
            clock: self.clock,
            servo: self.servo,
            record: self.record.clone(),
        }
    }
}

/// What was recorded: for each quantity of the task, samples times joints.
pub type Record<const N: usize> = RecordOf<f64, N>;

/// A record of numbers of any kind.
pub type RecordOf<S, const N: usize> = Vec<Vec<[S; N]>>;

/// The plain numbers of a record.
pub fn values<S: Real, const N: usize>(record: &RecordOf<S, N>) -> Record<N> {
    let plain = |row: &[S; N]| row.map(|value| value.lane(0));
    record
        .iter()
        .map(|rows| rows.iter().map(plain).collect())
        .collect()
}

/// A number that a motion depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The parameter of this place in [`Config::parameter_names`].
    Parameter(usize),
    /// A joint's first motor angle.
    MotorAngle(usize),
    /// A joint's first motor velocity.
    MotorVelocity(usize),
    /// A joint's first link angle, or what is added to the angle where it hangs.
    LinkAngle(usize),
    /// A joint's first link velocity.
    LinkVelocity(usize),
}

/// A motion that left the finite numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diverged {
    /// When [s].
    pub time: f64,
}

/// What the clock asks for at one step.
pub(crate) struct Event {
    pub(crate) commands: bool,
    pub(crate) servo_reads: bool,
    pub(crate) samples: bool,
    pub(crate) last: bool,
}
