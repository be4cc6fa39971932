//! Known constants of an arm, the names of its parameters, and the [`Plant`] for a flat list of
//! parameter values.

use crate::actuation::current_loop::CurrentLoop;
pub use crate::arm::Name;

use crate::arm::Arm;
use crate::joint::Joint;
use crate::joint::effects::{self, EffectKinds, Effects};
use crate::joint::gear::{self, Gears, Law, MAX_LAW_PARAMETERS};
use crate::joint::transmission::{DRIVE, GEAR_DAMPING, SETTLING};
use crate::parameter::Parameter;
use crate::plant::Plant;
use crate::scalar::Real;

/// Known constants of a joint.
#[derive(Clone, Copy, Debug)]
pub struct JointConfig {
    /// Elastic law of the gear.
    pub gear: Law,
    /// n, link turns per motor turn.
    pub ratio: f64,
    /// e [N m/V] at the motor.
    pub torque_per_volt: f64,
    /// Bandwidth [Hz] of the current loop; `None`: no lag.
    pub current_loop_hz: Option<f64>,
    /// Encoder counts per motor turn; `None`: an ideal encoder.
    pub encoder_counts: Option<f64>,
    /// Bandwidth [Hz] of the accelerometer; `None`: an ideal accelerometer.
    pub accelerometer_hz: Option<f64>,
    /// Bandwidth [Hz] of the gyro; `None`: an ideal gyro.
    pub gyro_hz: Option<f64>,
    /// Bandwidth [Hz] of the accelerometers of the link's IMU; `None`: ideal accelerometers.
    pub imu_accelerometer_hz: Option<f64>,
    /// Bandwidth [Hz] of the gyros of the link's IMU; `None`: ideal gyros.
    pub imu_gyro_hz: Option<f64>,
    /// Effects of the joint. A joint with a rigid gear has only effects that do not require an
    /// elastic gear.
    pub effects: EffectKinds,
}

/// An arm with its known constants.
#[derive(Clone, Copy, Debug)]
pub struct Config<A, const N: usize> {
    /// The arm with its geometry.
    pub arm: A,
    /// Half width [rad] of the rounded knees of three-slope springs.
    pub corner: f64,
    /// The joints, from the base; entries beyond the arm's joints are not read.
    pub joints: [JointConfig; N],
}

/// An impossible parameter value.
#[derive(Clone, Debug, PartialEq)]
pub struct InvalidParameter {
    /// Name of the parameter.
    pub name: Name,
    /// Value of the parameter.
    pub value: f64,
    /// Requirement on the value.
    pub must: String,
}

impl std::fmt::Display for InvalidParameter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (name, joint) = self.name;
        let of = joint.map_or(String::new(), |joint| format!(" of joint {joint}"));
        write!(f, "{name}{of} is {}, but must be {}", self.value, self.must)
    }
}

/// Role of a parameter in the equations, with its index among the parameters of the same kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// A base parameter of the arm.
    Base(usize),
    /// One of [`DRIVE`].
    Drive(usize),
    /// A parameter of the gear's law.
    Gear(usize),
    /// d_G.
    Damping,
    /// tau.
    Settling,
    /// A parameter of the joint's effects.
    Effect(usize),
}

/// Owner of a parameter, and its declaration.
pub type OwnedParameter = (&'static str, Parameter);

/// Parameters of joints of any arm, once per owner: the drive, the gear laws by name, every elastic
/// gear, and the effects by name.
pub fn joint_parameters() -> Vec<OwnedParameter> {
    let of = |owner, parameters: &[Parameter]| {
        parameters
            .iter()
            .map(|&one| (owner, one))
            .collect::<Vec<_>>()
    };
    let mut all = of("drive", &DRIVE);
    for law in gear::all_laws() {
        all.extend(of(law.name, law.parameters));
    }
    all.extend(of("gear", &[GEAR_DAMPING, SETTLING]));
    for effect in effects::DECLARATIONS {
        all.extend(of(effect.name, effect.parameters));
    }
    all
}

impl JointConfig {
    /// The joint's parameters, in the order of a flat list of values.
    pub(crate) fn parameters(&self) -> Vec<(Role, Parameter)> {
        let mut all = number_parameters(&DRIVE, Role::Drive);
        if self.gear.elastic {
            all.extend(number_parameters(self.gear.parameters, Role::Gear));
            all.extend([(Role::Damping, GEAR_DAMPING), (Role::Settling, SETTLING)]);
        }
        let of_effects: Vec<_> = self
            .effects
            .parameters()
            .iter()
            .map(|one| one.parameter)
            .collect();
        all.extend(number_parameters(&of_effects, Role::Effect));
        all
    }
}

fn number_parameters(parameters: &[Parameter], role: fn(usize) -> Role) -> Vec<(Role, Parameter)> {
    let each = |(index, &parameter)| (role(index), parameter);
    parameters.iter().enumerate().map(each).collect()
}

impl<A: Arm<N>, const N: usize> Config<A, N> {
    /// Constants of the arm's joints.
    pub(crate) fn joints(&self) -> &[JointConfig] {
        &self.joints[..self.arm.joints()]
    }

    /// Names of the parameters, in the order of flat lists of values.
    pub fn parameter_names(&self) -> Vec<Name> {
        let mut names = self.arm.names();
        for (i, joint) in self.joints().iter().enumerate() {
            let parameters = joint.parameters().into_iter();
            names.extend(parameters.map(|(_, parameter)| (parameter.name, Some(i + 1))));
        }
        names
    }

    /// Roles of the parameters in that order, with their joints from 0.
    pub(crate) fn roles(&self) -> Vec<(Role, usize)> {
        let mut roles: Vec<_> = (0..self.arm.names().len())
            .map(|k| (Role::Base(k), 0))
            .collect();
        for (i, joint) in self.joints().iter().enumerate() {
            roles.extend(joint.parameters().into_iter().map(|(role, _)| (role, i)));
        }
        roles
    }

    /// Checks a flat list of values, which must be as long as the list of names.
    ///
    /// # Errors
    /// The first impossible value.
    pub fn check(&self, values: &[f64]) -> Result<(), InvalidParameter> {
        let names = self.parameter_names();
        assert_eq!(values.len(), names.len());
        let invalid = |k: usize, must: &str| InvalidParameter {
            name: names[k],
            value: values[k],
            must: must.to_owned(),
        };
        let bases = self.arm.names().len();
        if let Some(k) = values[..bases].iter().position(|value| !value.is_finite()) {
            return Err(invalid(k, "finite"));
        }
        let parameters = self.joints().iter().flat_map(JointConfig::parameters);
        for (k, (_, parameter)) in (bases..).zip(parameters) {
            if !values[k].is_finite() || !parameter.sign.allows(values[k]) {
                return Err(invalid(k, parameter.sign.requirement()));
            }
        }
        let is_not_rising = |k: &usize| values[*k] <= values[k - 1];
        if let Some(k) = self.rising().into_iter().find(is_not_rising) {
            return Err(invalid(k, &format!("above {}", names[k - 1].0)));
        }
        self.check_arm(&names, values)
    }

    /// Indices of values that must exceed the previous one.
    fn rising(&self) -> Vec<usize> {
        let roles = self.roles();
        let must_rise = |&(role, i): &(Role, usize)| matches!(role, Role::Gear(index) if self.joints[i].gear.rising.contains(&index));
        (0..roles.len()).filter(|&k| must_rise(&roles[k])).collect()
    }

    fn check_arm(&self, names: &[Name], values: &[f64]) -> Result<(), InvalidParameter> {
        let value = |name: Name| names.iter().position(|&n| n == name).map(|k| values[k]);
        let reflected = std::array::from_fn(|i| {
            let joint = &self.joints[i];
            let motor = value((DRIVE[0].name, Some(i + 1))).filter(|_| !joint.gear.elastic)?;
            Some(motor / joint.ratio.powi(2))
        });
        let base = &values[..self.arm.names().len()];
        self.arm
            .check(base, &reflected)
            .map_err(|(k, must)| InvalidParameter {
                name: names[k],
                value: values[k],
                must: must.to_owned(),
            })
    }

    /// The arm with given parameter values.
    pub fn plant<R: Real, G: Gears, const EFFECTS: bool>(
        &self,
        values: &[f64],
    ) -> Plant<A, R, G, N, EFFECTS> {
        self.plant_of(|k| R::splat(values[k]))
    }

    /// The arm with value `value(k)` of the `k`-th parameter.
    pub fn plant_of<R: Real, G: Gears, const EFFECTS: bool>(
        &self,
        value: impl Fn(usize) -> R,
    ) -> Plant<A, R, G, N, EFFECTS> {
        assert!(self.has_gears::<G>());
        assert!(EFFECTS || !self.has_plant_effects());
        assert!(!EFFECTS || R::LANES == 1);
        let mut next = 0;
        let mut next_value = || {
            next += 1;
            value(next - 1)
        };
        let base: Vec<R> = self.arm.names().iter().map(|_| next_value()).collect();
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        let any_law = &self.joints[0].gear;
        let any_spring = G::spring(any_law, &[one; MAX_LAW_PARAMETERS], self.corner);
        let mut joints = [Joint::unused(any_spring); N];
        for (i, joint) in self.joints().iter().enumerate() {
            let [motor_inertia, motor_viscous, coulomb, offset, link_viscous] =
                DRIVE.map(|_| next_value());
            let mut of_law = [zero; MAX_LAW_PARAMETERS];
            for value in &mut of_law[..joint.gear.parameters.len()] {
                *value = next_value();
            }
            let spring = G::spring(&joint.gear, &of_law, self.corner);
            let [gear_damping, settling_time] = match joint.gear.elastic {
                true => [next_value(), next_value()],
                false => [zero; 2],
            };
            joints[i] = Joint {
                ratio: R::splat(joint.ratio),
                motor_inertia,
                motor_mobility: one / motor_inertia,
                motor_viscous,
                coulomb,
                settling_time,
                settling_rate: one / settling_time.max(R::splat(MIN_SETTLING_TIME)),
                offset,
                link_viscous,
                rigid: !joint.gear.elastic,
                spring,
                gear_damping,
                effects: Effects::of(joint.effects, &mut next_value),
            };
        }
        let settles = |joint: &Joint<R, G>| (-joint.settling_time).any_negative();
        Plant {
            base: self.arm.base(&base),
            arm: self.arm,
            settles: joints.iter().any(settles),
            joints,
        }
    }

    /// Whether all gears are elastic.
    pub fn is_elastic(&self) -> bool {
        self.joints().iter().all(|joint| joint.gear.elastic)
    }

    /// Whether all gears are in the set `G`.
    pub fn has_gears<G: Gears>(&self) -> bool {
        let has =
            |joint: &JointConfig| G::includes(&joint.gear) && (G::RIGID || joint.gear.elastic);
        self.joints().iter().all(has)
    }

    /// Whether any joint has one of [`crate::joint::effects`].
    pub fn has_effects(&self) -> bool {
        self.joints().iter().any(|joint| joint.effects.any())
    }

    /// Whether any joint has an effect on motor, gear or link, not only on its drive.
    pub fn has_plant_effects(&self) -> bool {
        let is_on_plant = |joint: &JointConfig| joint.effects != joint.effects.of_drive();
        self.joints().iter().any(is_on_plant)
    }

    /// Current loops for an integrator of step `h` [s].
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

/// Settling time [s] that is treated as zero; the inverse is finite.
const MIN_SETTLING_TIME: f64 = 1e-200;
