//! What is known of an arm beforehand, the names of what is not, and the way from a flat list of
//! parameter values to a [`Plant`].

use crate::actuation::current_loop::CurrentLoop;
pub use crate::arm::Name;

use crate::arm::Arm;
use crate::joint::Joint;
use crate::joint::effects::{EffectKinds, Effects};
use crate::joint::gear::Spring;
use crate::plant::Plant;
use crate::scalar::{Real, gather};

/// How a gear gives way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GearKind {
    /// One stiffness.
    Linear,
    /// Three stiffnesses and two knees.
    ThreeSlope,
    /// Not at all.
    Rigid,
}

/// One joint's known constants.
#[derive(Clone, Copy, Debug)]
pub struct JointConfig {
    /// How the gear gives way.
    pub gear: GearKind,
    /// n, link turns per motor turn.
    pub ratio: f64,
    /// e [N m/V] at the motor.
    pub torque_per_volt: f64,
    /// Bandwidth [Hz] of the current loop; `None`: the torque follows at once.
    pub current_loop_hz: Option<f64>,
    /// Encoder counts per motor turn; `None`: the angle itself.
    pub encoder_counts: Option<f64>,
    /// Bandwidth [Hz]; `None`: the acceleration itself.
    pub accelerometer_hz: Option<f64>,
    /// Bandwidth [Hz]; `None`: the rate itself.
    pub gyro_hz: Option<f64>,
    /// Bandwidth [Hz] of the accelerometers of the link's IMU; `None`: the signals themselves.
    pub imu_accelerometer_hz: Option<f64>,
    /// Bandwidth [Hz] of its gyros.
    pub imu_gyro_hz: Option<f64>,
    /// What the joint has beyond spring and dry friction; a rigid gear has Stribeck's friction at
    /// most.
    pub effects: EffectKinds,
}

/// An arm with all its known constants.
#[derive(Clone, Copy, Debug)]
pub struct Config<A, const N: usize> {
    /// The arm with its geometry.
    pub arm: A,
    /// Half width [rad] of the three-slope springs' rounded knees.
    pub corner: f64,
    /// The joints, from the base.
    pub joints: [JointConfig; N],
}

/// A value that no arm can have.
#[derive(Clone, Debug, PartialEq)]
pub struct InvalidParameter {
    /// Which.
    pub name: Name,
    /// Its value.
    pub value: f64,
    /// What it must be.
    pub must: &'static str,
}

impl std::fmt::Display for InvalidParameter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (name, joint) = self.name;
        let of = joint.map_or(String::new(), |joint| format!(" of joint {joint}"));
        write!(f, "{name}{of} is {}, but must be {}", self.value, self.must)
    }
}

const DRIVE: [&str; 5] = [
    "motor_inertia",
    "motor_viscous_friction",
    "motor_coulomb_friction",
    "friction_offset",
    "link_viscous_friction",
];

/// How fast friction brings a motor to rest; an elastic gear's motor alone has it.
pub(crate) const SETTLING: &str = "friction_settling_time";

impl GearKind {
    fn names(self) -> &'static [&'static str] {
        match self {
            GearKind::Linear => &["gear_stiffness", "gear_damping", SETTLING],
            GearKind::ThreeSlope => &[
                "gear_stiffness_k1",
                "gear_stiffness_k2",
                "gear_stiffness_k3",
                "gear_knee_t1",
                "gear_knee_t2",
                "gear_damping",
                SETTLING,
            ],
            GearKind::Rigid => &[],
        }
    }
}

impl<A: Arm<N>, const N: usize> Config<A, N> {
    /// Names of the parameters, in the order every flat list of values has.
    pub fn parameter_names(&self) -> Vec<Name> {
        let mut names = self.arm.names();
        for (i, joint) in self.joints.iter().enumerate() {
            let own = DRIVE
                .iter()
                .chain(joint.gear.names())
                .chain(joint.effects.names());
            names.extend(own.map(|name| (*name, Some(i + 1))));
        }
        names
    }

    /// Checks one flat list of values.
    ///
    /// # Errors
    /// The first value that no arm can have. The number of values is the caller's to check.
    pub fn check(&self, values: &[f64]) -> Result<(), InvalidParameter> {
        let names = self.parameter_names();
        assert_eq!(values.len(), names.len());
        let of_the_arm = self.arm.names().len();
        for (k, (&name, &value)) in names.iter().zip(values).enumerate() {
            let (ok, must) = match name.0 {
                _ if k < of_the_arm => (true, "finite"),
                "friction_offset" | "kinematic_error_cos" | "kinematic_error_sin" => {
                    (true, "finite")
                }
                "motor_viscous_friction"
                | "motor_coulomb_friction"
                | "link_viscous_friction"
                | "gear_damping"
                | "stribeck_friction"
                | "hysteresis_torque"
                | SETTLING => (value >= 0.0, "zero or positive"),
                _ => (value > 0.0, "positive"),
            };
            if !value.is_finite() || !ok {
                return Err(InvalidParameter { name, value, must });
            }
        }
        self.check_knees(&names, values)?;
        self.check_arm(&names, values)
    }

    fn check_knees(&self, names: &[Name], values: &[f64]) -> Result<(), InvalidParameter> {
        for k in 1..names.len() {
            if names[k].0 == "gear_knee_t2" && values[k] <= values[k - 1] {
                return Err(InvalidParameter {
                    name: names[k],
                    value: values[k],
                    must: "above gear_knee_t1",
                });
            }
        }
        Ok(())
    }

    fn check_arm(&self, names: &[Name], values: &[f64]) -> Result<(), InvalidParameter> {
        let value = |name: Name| names.iter().position(|&n| n == name).map(|k| values[k]);
        let reflected = std::array::from_fn(|i| {
            let joint = &self.joints[i];
            let rigid = joint.gear == GearKind::Rigid;
            let motor = value(("motor_inertia", Some(i + 1))).filter(|_| rigid)?;
            Some(motor / joint.ratio.powi(2))
        });
        let base = &values[..self.arm.names().len()];
        self.arm
            .check(base, &reflected)
            .map_err(|(k, must)| InvalidParameter {
                name: names[k],
                value: values[k],
                must,
            })
    }

    /// The arm with given parameter values: lane `l` gets those of `values[l]`.
    pub fn plant<R: Real, const ELASTIC: bool, const EFFECTS: bool>(
        &self,
        values: &[&[f64]],
    ) -> Plant<A, R, N, ELASTIC, EFFECTS> {
        assert_eq!(values.len(), R::LANES);
        self.plant_of(|k| gather(|lane| R::One::splat(values[lane][k])))
    }

    /// The arm whose `k`-th parameter is `value(k)`.
    pub fn plant_of<R: Real, const ELASTIC: bool, const EFFECTS: bool>(
        &self,
        value: impl Fn(usize) -> R,
    ) -> Plant<A, R, N, ELASTIC, EFFECTS> {
        assert!(!ELASTIC || self.is_elastic());
        assert!(EFFECTS || !self.has_effects());
        assert!(!EFFECTS || R::LANES == 1);
        let mut next = 0;
        let mut take = || {
            next += 1;
            value(next - 1)
        };
        let base: Vec<R> = self.arm.names().iter().map(|_| take()).collect();
        let joints = self.joints.map(|joint| {
            let [motor_inertia, motor_viscous, coulomb, offset, link_viscous] =
                DRIVE.map(|_| take());
            let zero = R::splat(0.0);
            let (spring, gear_damping, settling_time) = match joint.gear {
                GearKind::Rigid => (Spring::linear(R::splat(1.0)), zero, zero),
                GearKind::Linear => (Spring::linear(take()), take(), take()),
                GearKind::ThreeSlope => {
                    let slopes = [take(), take(), take()];
                    let knees = [take(), take()];
                    let spring = Spring::three_slope(slopes, knees, self.corner);
                    (spring, take(), take())
                }
            };
            Joint {
                ratio: R::splat(joint.ratio),
                motor_inertia,
                motor_mobility: R::splat(1.0) / motor_inertia,
                motor_viscous,
                coulomb,
                settling_time,
                settling_rate: R::splat(1.0) / settling_time.max(R::splat(AT_ONCE)),
                offset,
                link_viscous,
                rigid: joint.gear == GearKind::Rigid,
                spring,
                gear_damping,
                effects: Effects::of(joint.effects, &mut take),
            }
        });
        let settles = |joint: &Joint<R>| (-joint.settling_time).any_negative();
        Plant {
            base: self.arm.base(&base),
            arm: self.arm,
            settles: joints.iter().any(settles),
            joints,
        }
    }

    /// Whether no gear is rigid.
    pub fn is_elastic(&self) -> bool {
        self.joints
            .iter()
            .all(|joint| joint.gear != GearKind::Rigid)
    }

    /// Whether any joint has one of [`crate::joint::effects`].
    pub fn has_effects(&self) -> bool {
        self.joints.iter().any(|joint| joint.effects.any())
    }

    /// The current loops for an integrator of step `h` [s].
    pub fn current_loop<R: Real>(&self, h: f64) -> CurrentLoop<R, N> {
        CurrentLoop::new(
            self.joints.map(|joint| joint.torque_per_volt),
            self.joints.map(|joint| {
                joint
                    .current_loop_hz
                    .map_or(f64::INFINITY, |hz| std::f64::consts::TAU * hz)
            }),
            h,
        )
    }
}

/// Settling time [s] that counts as none; its inverse is a number still.
const AT_ONCE: f64 = 1e-200;
