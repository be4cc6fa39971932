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
pub const MOST_OF_AN_EFFECT: usize = 4;

/// Terms of the equations that an effect changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Enters {
    /// Limit of dry friction.
    pub friction: bool,
    /// Torque of the motor.
    pub motor: bool,
    /// Torque of the gear.
    pub gear: bool,
    /// Load on the link. An effect enters by this or by `weight`.
    pub link: bool,
    /// Load on the link and on those before it.
    pub weight: bool,
    /// Effective voltage.
    pub drive: bool,
}

/// No term.
pub const NOWHERE: Enters = Enters {
    friction: false,
    motor: false,
    gear: false,
    link: false,
    weight: false,
    drive: false,
};

/// Declaration of an effect.
#[derive(Clone, Copy, Debug)]
pub struct Declared {
    /// Name in study files.
    pub name: &'static str,
    /// Parameters in the order of a flat list of values; the sizes come first.
    pub parameters: &'static [Parameter],
    /// Number of sizes. With all sizes zero the effect vanishes.
    pub sizes: usize,
    /// Whether it requires an elastic gear.
    pub of_gear: bool,
    /// Terms that it changes.
    pub enters: Enters,
}

/// A gear's torsion [rad] and its rate [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Twist<R> {
    /// delta.
    pub angle: R,
    /// ddelta.
    pub rate: R,
}

/// Lead [rad] of the flexible part over its link, and its rate [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Lead<R> {
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
pub struct At<R> {
    /// theta_M [rad].
    pub motor_angle: R,
    /// dtheta_M [rad/s].
    pub motor_velocity: R,
    /// theta_L [rad].
    pub link_angle: R,
    /// Angle in space, or the joint's own angle if axes are not parallel [rad].
    pub angle_in_space: R,
    /// delta and its rate.
    pub twist: Twist<R>,
    /// Hysteresis state z of the gear.
    pub z: R,
    /// x and dx of the flexible part.
    pub lead: Lead<R>,
    /// Velocity of the flexible part in space [rad/s].
    pub part_velocity: R,
    /// s and ds of the spring under the base.
    pub base: BaseTorque<R>,
}

/// An effect with its values. The defaults change nothing. All methods that a step of the
/// integrator calls are `#[inline(always)]`.
pub trait Effect<R: Real>: Copy + Send + Sync {
    /// Declaration.
    const DECLARED: Declared;

    /// The effect with given values of its parameters.
    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self;

    /// Friction limit beyond Coulomb's [N m] at a motor velocity [rad/s] and a gear torque at the
    /// motor [N m]; enters by `friction`.
    #[inline(always)]
    fn dry_friction(&self, _velocity: R, _load: R) -> R {
        R::splat(0.0)
    }

    /// Torque added to the motor's [N m]; enters by `motor`.
    #[inline(always)]
    fn motor_torque(&self, _angle: R, _velocity: R) -> R {
        R::splat(0.0)
    }

    /// Error of the link's angle [rad], and its derivative with respect to the motor's angle;
    /// enters by `gear` and `motor`.
    #[inline(always)]
    fn error(&self, _motor_angle: R) -> [R; 2] {
        [R::splat(0.0); 2]
    }

    /// Torsion [rad] that strains the gear's spring; enters by `gear`.
    #[inline(always)]
    fn strain(&self, torsion: R) -> R {
        torsion
    }

    /// Inverse of [`Effect::strain`].
    fn torsion(&self, strain: R) -> R {
        strain
    }

    /// Torque added to the gear's [N m] in a hysteresis state; enters by `gear`.
    #[inline(always)]
    fn gear_torque(&self, _z: R) -> R {
        R::splat(0.0)
    }

    /// Hysteresis state after a time [s] between two torsions.
    #[inline(always)]
    fn after(&self, z: R, _from: &Twist<R>, _to: &Twist<R>, _time: R) -> R {
        z
    }

    /// Second derivative [N m/s^2] of the torque of the spring under the base, at a gear torque [N
    /// m]; enters by `gear`.
    #[inline(always)]
    fn base_acceleration(&self, _base: &BaseTorque<R>, _gear: R) -> R {
        R::splat(0.0)
    }

    /// Rotation of the base [rad] at a torque of its spring [N m], or the rates of both; linear,
    /// enters by `gear`.
    #[inline(always)]
    fn base_turn(&self, _torque: R) -> R {
        R::splat(0.0)
    }

    /// Load torque on the link [N m] at its joint angle [rad]; enters by `link`.
    #[inline(always)]
    fn load(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// Load torque on the link [N m] and on those before it, at its angle in space [rad]; enters by
    /// `weight`. If axes are not parallel, the joint's own angle replaces the angle in space, and
    /// only the link itself bears the load.
    #[inline(always)]
    fn weight(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// Acceleration in space [rad/s^2] of the flexible part; enters by `weight`.
    #[inline(always)]
    fn part_acceleration(&self, _lead: &Lead<R>) -> R {
        R::splat(0.0)
    }

    /// Load torque of the flexible part [N m] on the link and on those before it, at an
    /// acceleration [rad/s^2]; enters by `weight`.
    #[inline(always)]
    fn part_load(&self, _acceleration: R) -> R {
        R::splat(0.0)
    }

    /// Effective voltage [V] for a commanded one; enters by `drive`.
    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        voltage
    }

    /// Mean effective voltage [V] over a step of the integrator [s], and the state of the drive at
    /// its end [V], for a voltage [V] and a state at the beginning; enters by `drive`.
    #[inline(always)]
    fn held(&self, voltage: R, memory: R, _time: f64) -> [R; 2] {
        [voltage, memory]
    }

    /// Recoverable energy [J], without the gear's spring.
    fn energy(&self, _at: &At<R>) -> R {
        R::splat(0.0)
    }

    /// Dissipated power [W], without dry friction.
    fn loss(&self, _at: &At<R>) -> R {
        R::splat(0.0)
    }
}

/// [`EffectKinds`], [`Effects`] and the sums over the list of effects.
macro_rules! effects {
    ($($field:ident: $effect:ident,)*) => {
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
        pub const DECLARED: &[Declared] = &[$(<$effect<f64> as Effect<f64>>::DECLARED),*];

        impl EffectKinds {
            /// All effects.
            pub const ALL: Self = Self { $($field: true),* };

            fn each(self) -> impl Iterator<Item = (bool, &'static Declared)> {
                [$(self.$field),*].into_iter().zip(DECLARED)
            }

            /// The selected effects of the drive.
            pub(crate) fn of_drive(self) -> Self {
                Self {
                    $($field: self.$field && <$effect<f64> as Effect<f64>>::DECLARED.enters.drive),*
                }
            }

            /// Selects the effect of a name; false if there is none.
            pub fn add(&mut self, name: &str) -> bool {
                $(
                    if name == <$effect<f64> as Effect<f64>>::DECLARED.name {
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

            /// Effects of a selection; `take` gives their parameters in order.
            pub(crate) fn of(kinds: EffectKinds, mut take: impl FnMut() -> R) -> Self {
                let mut all = Self::NONE;
                $(
                    if kinds.$field {
                        let mut values = [R::splat(0.0); MOST_OF_AN_EFFECT];
                        let count = <$effect<R> as Effect<R>>::DECLARED.parameters.len();
                        for value in &mut values[..count] {
                            *value = take();
                        }
                        all.$field = Some($effect::of(&values));
                    }
                )*
                all
            }

            /// Sum of [`Effect::dry_friction`].
            #[inline(always)]
            pub(crate) fn dry_friction(&self, velocity: R, load: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.friction
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.dry_friction(velocity, load);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::motor_torque`].
            #[inline(always)]
            pub(crate) fn motor_torque(&self, angle: R, velocity: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.motor
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.motor_torque(angle, velocity);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::error`].
            #[inline(always)]
            pub(crate) fn error(&self, motor_angle: R) -> [R; 2] {
                let mut sum = [R::splat(0.0); 2];
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        let [off, slope] = own.error(motor_angle);
                        sum = [sum[0] + off, sum[1] + slope];
                    }
                )*
                sum
            }

            /// Composition of [`Effect::strain`].
            #[inline(always)]
            pub(crate) fn strain(&self, torsion: R) -> R {
                let mut strain = torsion;
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        strain = own.strain(strain);
                    }
                )*
                strain
            }

            /// Composition of [`Effect::torsion`].
            pub(crate) fn torsion(&self, strain: R) -> R {
                let mut torsion = strain;
                $(
                    if let Some(own) = &self.$field {
                        torsion = own.torsion(torsion);
                    }
                )*
                torsion
            }

            /// Sum of [`Effect::gear_torque`].
            #[inline(always)]
            pub(crate) fn gear_torque(&self, z: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.gear_torque(z);
                    }
                )*
                sum
            }

            /// [`Effect::after`].
            #[inline(always)]
            pub(crate) fn after(&self, z: R, from: &Twist<R>, to: &Twist<R>, time: R) -> R {
                let mut after = z;
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        after = own.after(after, from, to, time);
                    }
                )*
                after
            }

            /// Sum of [`Effect::base_acceleration`].
            #[inline(always)]
            pub(crate) fn base_acceleration(&self, base: &BaseTorque<R>, gear: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.base_acceleration(base, gear);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::base_turn`].
            #[inline(always)]
            pub(crate) fn base_turn(&self, torque: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.gear
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.base_turn(torque);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::load`].
            #[inline(always)]
            pub(crate) fn load(&self, angle: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.link
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.load(angle);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::weight`].
            #[inline(always)]
            pub(crate) fn weight(&self, angle: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.weight
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.weight(angle);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::part_acceleration`].
            #[inline(always)]
            pub(crate) fn part_acceleration(&self, lead: &Lead<R>) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.weight
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.part_acceleration(lead);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::part_load`].
            #[inline(always)]
            pub(crate) fn part_load(&self, acceleration: R) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.weight
                        && let Some(own) = &self.$field
                    {
                        sum = sum + own.part_load(acceleration);
                    }
                )*
                sum
            }

            /// Composition of [`Effect::drive`].
            #[inline(always)]
            pub(crate) fn drive(&self, voltage: R) -> R {
                let mut driven = voltage;
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.drive
                        && let Some(own) = &self.$field
                    {
                        driven = own.drive(driven);
                    }
                )*
                driven
            }

            /// [`Effect::held`].
            #[inline(always)]
            pub(crate) fn held(&self, voltage: R, memory: R, time: f64) -> [R; 2] {
                let mut held = [voltage, memory];
                $(
                    if <$effect<R> as Effect<R>>::DECLARED.enters.drive
                        && let Some(own) = &self.$field
                    {
                        held = own.held(held[0], held[1], time);
                    }
                )*
                held
            }

            /// Sum of [`Effect::energy`].
            pub(crate) fn energy(&self, at: &At<R>) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if let Some(own) = &self.$field {
                        sum = sum + own.energy(at);
                    }
                )*
                sum
            }

            /// Sum of [`Effect::loss`].
            pub(crate) fn loss(&self, at: &At<R>) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if let Some(own) = &self.$field {
                        sum = sum + own.loss(at);
                    }
                )*
                sum
            }
        }
    };
}

effects! {
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
    pub(crate) enters: Enters,
}

/// Number of sizes of all effects.
pub(crate) const SIZES: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARED.len() {
        sum += DECLARED[k].sizes;
        k += 1;
    }
    sum
};

/// Number of parameters of all effects.
pub(crate) const MOST_OF_EFFECTS: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARED.len() {
        sum += DECLARED[k].parameters.len();
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
        let own = self.each().find(|(has, declared)| *has && declared.of_gear);
        own.map(|(_, declared)| declared.name)
    }

    /// Parameters of the selected effects.
    pub(crate) fn parameters(self) -> Vec<EffectParameter> {
        let (mut all, mut index) = (Vec::new(), 0);
        for (has, declared) in self.each() {
            for (place, &parameter) in declared.parameters.iter().enumerate() {
                let size = (place < declared.sizes).then_some(Size {
                    index: index + place,
                    enters: declared.enters,
                });
                if has {
                    all.push(EffectParameter {
                        parameter,
                        size,
                        of_drive: declared.enters.drive,
                    });
                }
            }
            index += declared.sizes;
        }
        all
    }
}
