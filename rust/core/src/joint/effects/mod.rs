//! Optional effects of gears and motors beyond springs and dry friction; one effect per file.
//!
//! To add an effect, implement [`Effect`] for it in a file here and name it in the list below.
//! Integrator, friction events, sensitivities and tests use the list.
//!
//! Effects cost exponentials and sines in the innermost loop, so a [`crate::plant::Plant`] states
//! at compile time whether it has any.

mod backlash;
mod dead_zone;
mod drive_gain;
mod drive_lag;
mod drive_limit;
mod drive_saturation;
mod flexible_link;
mod ground_spring;
mod hysteresis;
mod kinematic_error;
mod load_friction;
mod power_friction;
mod soft_base;
mod stribeck;
mod tilt;
mod torque_ripple;

pub use backlash::Backlash;
pub use dead_zone::DeadZone;
pub use drive_gain::DriveGain;
pub use drive_lag::DriveLag;
pub use drive_limit::DriveLimit;
pub use drive_saturation::DriveSaturation;
pub use flexible_link::FlexibleLink;
pub use ground_spring::GroundSpring;
pub use hysteresis::Hysteresis;
pub use kinematic_error::KinematicError;
pub use load_friction::LoadFriction;
pub use power_friction::PowerFriction;
pub use soft_base::SoftBase;
pub use stribeck::Stribeck;
pub use tilt::Tilt;
pub use torque_ripple::TorqueRipple;

use crate::parameter::Parameter;
use crate::scalar::Real;

/// Largest number of parameters of an effect.
pub const MAX_EFFECT_PARAMETERS: usize = 4;

/// Terms of the equations that an effect changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AffectedTerms {
    /// Limit of dry friction.
    pub friction: bool,
    /// Torque of the motor.
    pub motor: bool,
    /// Torque of the gear.
    pub gear: bool,
    /// Angle of the gear's output.
    pub output: bool,
    /// Load on the link. An effect affects this term or `weight`, not both.
    pub link: bool,
    /// Load on the link and on all preceding links.
    pub weight: bool,
    /// Effective voltage.
    pub drive: bool,
}

/// No term.
pub const NO_TERMS: AffectedTerms = AffectedTerms {
    friction: false,
    motor: false,
    gear: false,
    output: false,
    link: false,
    weight: false,
    drive: false,
};

/// Declaration of an effect.
#[derive(Clone, Copy, Debug)]
pub struct EffectDeclaration {
    /// Name in study files.
    pub name: &'static str,
    /// Parameters in the order of a flat list of values; the sizes come first.
    pub parameters: &'static [Parameter],
    /// Number of sizes. With all sizes zero the effect vanishes.
    pub sizes: usize,
    /// Whether it requires an elastic gear.
    pub of_gear: bool,
    /// Terms that it changes.
    pub affects: AffectedTerms,
}

/// A gear's torsion [rad] and its rate [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Torsion<R> {
    /// delta.
    pub angle: R,
    /// ddelta.
    pub rate: R,
}

/// Deflection [rad] of the flexible part relative to its link, and its rate [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct PartDeflection<R> {
    /// x.
    pub angle: R,
    /// dx.
    pub rate: R,
}

/// Torque [N m] of the spring under a joint's base, and its rate [N m/s].
#[derive(Clone, Copy, Debug)]
pub struct BaseTorque<R> {
    /// s.
    pub torque: R,
    /// ds.
    pub rate: R,
}

/// State of a joint at one instant.
#[derive(Clone, Copy, Debug)]
pub struct JointState<R> {
    /// theta_M [rad].
    pub motor_angle: R,
    /// dtheta_M [rad/s].
    pub motor_velocity: R,
    /// theta_L [rad].
    pub link_angle: R,
    /// Angle in space, or the joint's own angle if axes are not parallel [rad].
    pub angle_in_space: R,
    /// delta and its rate.
    pub torsion: Torsion<R>,
    /// Hysteresis state z of the gear.
    pub z: R,
    /// x and dx of the flexible part.
    pub deflection: PartDeflection<R>,
    /// Velocity of the flexible part in space [rad/s].
    pub part_velocity: R,
    /// s and ds of the spring under the base.
    pub base: BaseTorque<R>,
}

/// An effect with its values. The default methods have no effect. All methods that a step of the
/// integrator calls are `#[inline(always)]`.
pub trait Effect<R: Real>: Copy + Send + Sync {
    /// Declaration.
    const DECLARATION: EffectDeclaration;

    /// The effect with given values of its parameters.
    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self;

    /// Friction limit beyond Coulomb's [N m] at a motor velocity [rad/s] and a gear torque at the
    /// motor [N m]; affects `friction`.
    #[inline(always)]
    fn dry_friction(&self, _velocity: R, _load: R) -> R {
        R::splat(0.0)
    }

    /// Torque added to the motor's [N m]; affects `motor`.
    #[inline(always)]
    fn motor_torque(&self, _angle: R, _velocity: R) -> R {
        R::splat(0.0)
    }

    /// Error of the link's angle [rad], and its derivative with respect to the motor's angle;
    /// affects `gear`, `output` and `motor`.
    #[inline(always)]
    fn error(&self, _motor_angle: R) -> [R; 2] {
        [R::splat(0.0); 2]
    }

    /// Torsion [rad] that strains the gear's spring; affects `gear`.
    #[inline(always)]
    fn strain(&self, torsion: R) -> R {
        torsion
    }

    /// Inverse of [`Effect::strain`].
    fn torsion(&self, strain: R) -> R {
        strain
    }

    /// Torque added to the gear's [N m] in a hysteresis state; affects `gear`.
    #[inline(always)]
    fn gear_torque(&self, _z: R) -> R {
        R::splat(0.0)
    }

    /// Hysteresis state after a time [s] between two torsions.
    #[inline(always)]
    fn hysteresis_after(&self, z: R, _from: &Torsion<R>, _to: &Torsion<R>, _time: R) -> R {
        z
    }

    /// Second derivative [N m/s^2] of the torque of the spring under the base, at a gear torque [N
    /// m]; affects `gear`.
    #[inline(always)]
    fn base_acceleration(&self, _base: &BaseTorque<R>, _gear: R) -> R {
        R::splat(0.0)
    }

    /// Rotation of the base [rad] at a torque of its spring [N m], or the rates of both; linear;
    /// affects `gear`.
    #[inline(always)]
    fn base_rotation(&self, _torque: R) -> R {
        R::splat(0.0)
    }

    /// Load torque on the link [N m] at its joint angle [rad]; affects `link`.
    #[inline(always)]
    fn load(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// Load torque on the link [N m] and on all preceding links, at its angle in space [rad];
    /// affects `weight`. If axes are not parallel, the joint's own angle replaces the angle in
    /// space, and the load acts only on the link itself.
    #[inline(always)]
    fn weight(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// Acceleration in space [rad/s^2] of the flexible part; affects `weight`.
    #[inline(always)]
    fn part_acceleration(&self, _deflection: &PartDeflection<R>) -> R {
        R::splat(0.0)
    }

    /// Load torque of the flexible part [N m] on the link and on all preceding links, at an
    /// acceleration [rad/s^2]; affects `weight`.
    #[inline(always)]
    fn part_load(&self, _acceleration: R) -> R {
        R::splat(0.0)
    }

    /// Effective voltage [V] for a commanded one; affects `drive`.
    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        voltage
    }

    /// Mean effective voltage [V] over a step of the integrator [s], and the state of the drive at
    /// its end [V], for a voltage [V] and a state at the beginning; affects `drive`.
    #[inline(always)]
    fn hold_voltage(&self, voltage: R, memory: R, _time: f64) -> [R; 2] {
        [voltage, memory]
    }

    /// Recoverable energy [J], without the gear's spring.
    fn energy(&self, _at: &JointState<R>) -> R {
        R::splat(0.0)
    }

    /// Dissipated power [W], without dry friction.
    fn loss(&self, _at: &JointState<R>) -> R {
        R::splat(0.0)
    }
}

/// [`EffectKinds`], [`Effects`], and `for_each_effect!`, which runs code with each effect of a joint,
/// or with each that changes a term; `$` precedes the variables of the latter.
macro_rules! effects {
    ($dollar:tt $($field:ident: $effect:ident,)*) => {
        /// Selection of effects of a joint.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct EffectKinds {
            $(
                #[doc = concat!("See [`", stringify!($effect), "`].")]
                pub $field: bool,
            )*
        }

        /// Effects of one joint.
        #[derive(Clone, Copy)]
        pub struct Effects<R> {
            $(
                #[doc = concat!("See [`", stringify!($effect), "`].")]
                pub $field: Option<$effect<R>>,
            )*
        }

        /// Declarations of the effects, in the order of flat lists.
        pub const DECLARATIONS: &[EffectDeclaration] = &[$(<$effect<f64> as Effect<f64>>::DECLARATION),*];

        impl EffectKinds {
            /// All effects.
            pub const ALL: Self = Self { $($field: true),* };

            fn each(self) -> impl Iterator<Item = (bool, &'static EffectDeclaration)> {
                [$(self.$field),*].into_iter().zip(DECLARATIONS)
            }

            /// The selected effects of the drive.
            pub(crate) fn of_drive(self) -> Self {
                Self {
                    $($field: self.$field && <$effect<f64> as Effect<f64>>::DECLARATION.affects.drive),*
                }
            }

            /// Selects the effect of a name; false if there is none.
            pub fn add(&mut self, name: &str) -> bool {
                $(
                    if name == <$effect<f64> as Effect<f64>>::DECLARATION.name {
                        self.$field = true;
                        return true;
                    }
                )*
                false
            }
        }

        impl<R: Real> Effects<R> {
            /// No effect.
            pub const NONE: Self = Self { $($field: None),* };

            /// Effects of a selection; `next_value` returns their parameters in order.
            pub(crate) fn of(kinds: EffectKinds, mut next_value: impl FnMut() -> R) -> Self {
                let mut all = Self::NONE;
                $(
                    if kinds.$field {
                        let mut values = [R::splat(0.0); MAX_EFFECT_PARAMETERS];
                        let count = <$effect<R> as Effect<R>>::DECLARATION.parameters.len();
                        for value in &mut values[..count] {
                            *value = next_value();
                        }
                        all.$field = Some($effect::of(&values));
                    }
                )*
                all
            }
        }

        macro_rules! for_each_effect {
            ($dollar effects:expr, $dollar one:ident => $dollar code:expr) => {
                $(
                    if let Some($dollar one) = &$dollar effects.$field {
                        $dollar code;
                    }
                )*
            };
            ($dollar effects:expr, $dollar term:ident, $dollar one:ident => $dollar code:expr) => {
                $(
                    if <$effect<R> as Effect<R>>::DECLARATION.affects.$dollar term
                        && let Some($dollar one) = &$dollar effects.$field
                    {
                        $dollar code;
                    }
                )*
            };
        }
    };
}

effects! { $
    stribeck: Stribeck,
    hysteresis: Hysteresis,
    kinematic_error: KinematicError,
    load_friction: LoadFriction,
    power_friction: PowerFriction,
    torque_ripple: TorqueRipple,
    backlash: Backlash,
    ground_spring: GroundSpring,
    dead_zone: DeadZone,
    drive_gain: DriveGain,
    drive_saturation: DriveSaturation,
    drive_limit: DriveLimit,
    drive_lag: DriveLag,
    tilt: Tilt,
    flexible_link: FlexibleLink,
    soft_base: SoftBase,
}

/// Sums of methods over the effects that change a term.
macro_rules! sums {
    ($($term:ident: $name:ident($($argument:ident: $type:ty),*);)*) => {
        impl<R: Real> Effects<R> {$(
            #[doc = concat!("Sum of [`Effect::", stringify!($name), "`].")]
            #[inline(always)]
            pub(crate) fn $name(&self, $($argument: $type),*) -> R {
                let mut sum = R::splat(0.0);
                for_each_effect!(self, $term, one => sum = sum + one.$name($($argument),*));
                sum
            }
        )*}
    };
}

sums! {
    friction: dry_friction(velocity: R, load: R);
    motor: motor_torque(angle: R, velocity: R);
    gear: gear_torque(z: R);
    gear: base_acceleration(base: &BaseTorque<R>, gear: R);
    gear: base_rotation(torque: R);
    link: load(angle: R);
    weight: weight(angle: R);
    weight: part_acceleration(deflection: &PartDeflection<R>);
    weight: part_load(acceleration: R);
}

impl<R: Real> Effects<R> {
    /// Sum of [`Effect::error`].
    #[inline(always)]
    pub(crate) fn error(&self, motor_angle: R) -> [R; 2] {
        let mut sum = [R::splat(0.0); 2];
        for_each_effect!(self, gear, one => {
            let [error, slope] = one.error(motor_angle);
            sum = [sum[0] + error, sum[1] + slope];
        });
        sum
    }

    /// Composition of [`Effect::strain`].
    #[inline(always)]
    pub(crate) fn strain(&self, mut torsion: R) -> R {
        for_each_effect!(self, gear, one => torsion = one.strain(torsion));
        torsion
    }

    /// Composition of [`Effect::torsion`].
    pub(crate) fn torsion(&self, mut strain: R) -> R {
        for_each_effect!(self, one => strain = one.torsion(strain));
        strain
    }

    /// [`Effect::hysteresis_after`].
    #[inline(always)]
    pub(crate) fn hysteresis_after(
        &self,
        mut z: R,
        from: &Torsion<R>,
        to: &Torsion<R>,
        time: R,
    ) -> R {
        for_each_effect!(self, gear, one => z = one.hysteresis_after(z, from, to, time));
        z
    }

    /// Composition of [`Effect::drive`].
    #[inline(always)]
    pub(crate) fn drive(&self, mut voltage: R) -> R {
        for_each_effect!(self, drive, one => voltage = one.drive(voltage));
        voltage
    }

    /// [`Effect::hold_voltage`].
    #[inline(always)]
    pub(crate) fn hold_voltage(&self, voltage: R, memory: R, time: f64) -> [R; 2] {
        let mut now = [voltage, memory];
        for_each_effect!(self, drive, one => now = one.hold_voltage(now[0], now[1], time));
        now
    }

    /// Sum of [`Effect::energy`].
    pub(crate) fn energy(&self, at: &JointState<R>) -> R {
        let mut sum = R::splat(0.0);
        for_each_effect!(self, one => sum = sum + one.energy(at));
        sum
    }

    /// Sum of [`Effect::loss`].
    pub(crate) fn loss(&self, at: &JointState<R>) -> R {
        let mut sum = R::splat(0.0);
        for_each_effect!(self, one => sum = sum + one.loss(at));
        sum
    }
}

/// A parameter of a selected effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EffectParameter {
    /// Declaration.
    pub(crate) parameter: Parameter,
    /// Which size it is; `None` for others, such as velocities and exponents.
    pub(crate) size: Option<Size>,
    /// Whether the effect changes the drive.
    pub(crate) of_drive: bool,
}

/// A size of an effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Size {
    /// Index among the sizes of all effects.
    pub(crate) index: usize,
    /// Terms that the effect changes.
    pub(crate) affects: AffectedTerms,
}

/// Number of sizes of all effects.
pub(crate) const EFFECT_SIZE_COUNT: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARATIONS.len() {
        sum += DECLARATIONS[k].sizes;
        k += 1;
    }
    sum
};

/// Number of parameters of all effects.
pub(crate) const EFFECT_PARAMETER_COUNT: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARATIONS.len() {
        sum += DECLARATIONS[k].parameters.len();
        k += 1;
    }
    sum
};

impl EffectKinds {
    /// Whether any effect is selected.
    pub fn any(self) -> bool {
        self != Self::default()
    }

    /// Name of the first selected effect that requires an elastic gear.
    pub fn of_gear(self) -> Option<&'static str> {
        let effect = self
            .each()
            .find(|(has, declaration)| *has && declaration.of_gear);
        effect.map(|(_, declaration)| declaration.name)
    }

    /// Parameters of the selected effects.
    pub(crate) fn parameters(self) -> Vec<EffectParameter> {
        let (mut all, mut index) = (Vec::new(), 0);
        for (has, declaration) in self.each() {
            for (position, &parameter) in declaration.parameters.iter().enumerate() {
                let size = (position < declaration.sizes).then_some(Size {
                    index: index + position,
                    affects: declaration.affects,
                });
                if has {
                    all.push(EffectParameter {
                        parameter,
                        size,
                        of_drive: declaration.affects.drive,
                    });
                }
            }
            index += declaration.sizes;
        }
        all
    }
}
