//! What real gears and motors add to springs and dry friction, each on request; one effect a file.
//!
//! To add an effect, implement [`Effect`] for it in a file here and name it in the list below. The
//! integrator, the events of friction, the sensitivities and the tests take it as it is.
//!
//! All of it costs exponentials and sines in the innermost loop, so a [`crate::plant::Plant`] says at
//! compile time whether it has any.

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

/// Most parameters that an effect has.
pub const MOST_OF_AN_EFFECT: usize = 4;

/// Where an effect enters the equations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Enters {
    /// What dry friction can take up.
    pub friction: bool,
    /// The motor's torque.
    pub motor: bool,
    /// The torque through the gear.
    pub gear: bool,
    /// What the link bears. An effect enters by this or by `weight`.
    pub link: bool,
    /// What the link bears, and with it those before it.
    pub weight: bool,
    /// What the drive makes of a voltage.
    pub drive: bool,
}

/// In none of the equations.
pub const NOWHERE: Enters = Enters {
    friction: false,
    motor: false,
    gear: false,
    link: false,
    weight: false,
    drive: false,
};

/// What all else knows of an effect.
#[derive(Clone, Copy, Debug)]
pub struct Declared {
    /// As in a study file.
    pub name: &'static str,
    /// Its parameters, in the order of a flat list of values: first its sizes.
    pub parameters: &'static [Parameter],
    /// How many of these are sizes: where all are zero the effect is not there.
    pub sizes: usize,
    /// Whether it takes an elastic gear.
    pub of_gear: bool,
    /// Where it enters.
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

/// By how much a part that swings by itself is ahead of its link [rad], and the rate of that
/// [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Lead<R> {
    /// x.
    pub angle: R,
    /// dx.
    pub rate: R,
}

/// Torque [N m] in the spring that a joint's base turns on, and the rate of that [N m/s].
#[derive(Clone, Copy, Debug)]
pub struct BaseTorque<R> {
    /// s.
    pub torque: R,
    /// ds.
    pub rate: R,
}

/// A joint at one instant.
#[derive(Clone, Copy, Debug)]
pub struct At<R> {
    /// theta_M [rad].
    pub motor_angle: R,
    /// dtheta_M [rad/s].
    pub motor_velocity: R,
    /// theta_L [rad].
    pub link_angle: R,
    /// What [`Effect::weight`] depends on [rad].
    pub angle_in_space: R,
    /// delta and its rate.
    pub twist: Twist<R>,
    /// What the gear remembers.
    pub z: R,
    /// x and dx of the link's part that swings by itself.
    pub lead: Lead<R>,
    /// Velocity of that part in space [rad/s].
    pub part_velocity: R,
    /// s and ds of the spring that the base turns on.
    pub base: BaseTorque<R>,
}

/// An effect with its values. What it does not say is nothing; all methods that a step of the
/// integrator calls are `#[inline(always)]`.
pub trait Effect<R: Real>: Copy + Send + Sync {
    /// What is known of it beforehand.
    const DECLARED: Declared;

    /// The effect with given values of its parameters.
    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self;

    /// What dry friction can take up beyond Coulomb's [N m] at a velocity of the motor [rad/s] and
    /// a torque of the gear at the motor [N m]; enters by `friction`.
    #[inline(always)]
    fn dry_friction(&self, _velocity: R, _load: R) -> R {
        R::splat(0.0)
    }

    /// What adds to the motor's torque [N m]; enters by `motor`.
    #[inline(always)]
    fn motor_torque(&self, _angle: R, _velocity: R) -> R {
        R::splat(0.0)
    }

    /// By how much the link's angle is off its motor's [rad], and the slope of that by the motor's
    /// angle; enters by `gear` and `motor`.
    #[inline(always)]
    fn error(&self, _motor_angle: R) -> [R; 2] {
        [R::splat(0.0); 2]
    }

    /// What the gear's spring feels of a torsion [rad]; enters by `gear`.
    #[inline(always)]
    fn strain(&self, torsion: R) -> R {
        torsion
    }

    /// The torsion of which the spring feels so much: the inverse of [`Effect::strain`].
    fn torsion(&self, strain: R) -> R {
        strain
    }

    /// What adds to the gear's torque [N m] for what it remembers; enters by `gear`.
    #[inline(always)]
    fn gear_torque(&self, _z: R) -> R {
        R::splat(0.0)
    }

    /// What the gear remembers after a time [s] in which its torsion went from one place to another.
    #[inline(always)]
    fn after(&self, z: R, _from: &Twist<R>, _to: &Twist<R>, _time: R) -> R {
        z
    }

    /// Second derivative [N m/s^2] of the torque in the spring that the base turns on, where the gear
    /// passes a torque [N m]; enters by `gear`.
    #[inline(always)]
    fn base_acceleration(&self, _base: &BaseTorque<R>, _gear: R) -> R {
        R::splat(0.0)
    }

    /// What the base turns by [rad] at a torque in its spring [N m], or the rates of both; linear,
    /// enters by `gear`.
    #[inline(always)]
    fn base_turn(&self, _torque: R) -> R {
        R::splat(0.0)
    }

    /// What the link bears [N m] at an angle of its joint [rad]; enters by `link`.
    #[inline(always)]
    fn load(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// What the link bears [N m] at its angle in space [rad], and the joints before it with it;
    /// enters by `weight`. Where an arm's axes are not parallel, the joint's own angle stands for
    /// the one in space, and no other joint bears any of it.
    #[inline(always)]
    fn weight(&self, _angle: R) -> R {
        R::splat(0.0)
    }

    /// Acceleration in space [rad/s^2] of a part of the link that swings by itself; enters by
    /// `weight`.
    #[inline(always)]
    fn part_acceleration(&self, _lead: &Lead<R>) -> R {
        R::splat(0.0)
    }

    /// What the link bears of that part [N m] at an acceleration [rad/s^2], and the joints before it
    /// with it; enters by `weight`.
    #[inline(always)]
    fn part_load(&self, _acceleration: R) -> R {
        R::splat(0.0)
    }

    /// What the drive makes of a voltage [V] that is commanded; enters by `drive`.
    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        voltage
    }

    /// What acts on the mean [V] over a step of the integrator [s] in which the drive is to follow a
    /// voltage [V], and what the drive remembers at its end [V], from what it remembers at its
    /// beginning; enters by `drive`.
    #[inline(always)]
    fn held(&self, voltage: R, memory: R, _time: f64) -> [R; 2] {
        [voltage, memory]
    }

    /// What can be got back of the work done on it [J], the spring's apart.
    fn energy(&self, _at: &At<R>) -> R {
        R::splat(0.0)
    }

    /// Power [W] that it takes out, that of dry friction apart.
    fn loss(&self, _at: &At<R>) -> R {
        R::splat(0.0)
    }
}

/// [`EffectKinds`], [`Effects`] and what goes through the list of effects.
macro_rules! effects {
    ($($field:ident: $effect:ident,)*) => {
        /// Which of the effects a joint has.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct EffectKinds {
            $(
                #[doc = concat!("See [`", stringify!($effect), "`].")]
                pub $field: bool,
            )*
        }

        /// The effects of one joint.
        #[derive(Clone, Copy)]
        pub struct Effects<R> {
            $(
                #[doc = concat!("See [`", stringify!($effect), "`].")]
                pub $field: Option<$effect<R>>,
            )*
        }

        /// What is known of each effect, in the order of flat lists.
        pub const DECLARED: &[Declared] = &[$(<$effect<f64> as Effect<f64>>::DECLARED),*];

        impl EffectKinds {
            /// All of them.
            pub const ALL: Self = Self { $($field: true),* };

            fn each(self) -> impl Iterator<Item = (bool, &'static Declared)> {
                [$(self.$field),*].into_iter().zip(DECLARED)
            }

            /// Whether there was an effect of that name to add.
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
            /// None.
            pub const NONE: Self = Self { $($field: None),* };

            /// Those of the given kinds, their parameters taken in the order of their names.
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

            /// Beyond Coulomb's friction.
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

            /// What adds to the motor's torque.
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

            /// How far the link is off its motor, and the slope of that.
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

            /// What the spring feels of a torsion.
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

            /// The torsion of which the spring feels so much.
            pub(crate) fn torsion(&self, strain: R) -> R {
                let mut torsion = strain;
                $(
                    if let Some(own) = &self.$field {
                        torsion = own.torsion(torsion);
                    }
                )*
                torsion
            }

            /// What adds to the gear's torque.
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

            /// What the gear remembers.
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

            /// Second derivative of the torque in the spring that the base turns on.
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

            /// What the base turns by.
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

            /// What the link bears.
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

            /// What the link and those before it bear.
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

            /// Acceleration of the part of the link that swings by itself.
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

            /// What the link and those before it bear of that part.
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

            /// What the drive makes of a voltage: one effect after the other.
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

            /// What acts of a voltage while it is held, and what the drive remembers at the end.
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

            /// What can be got back.
            pub(crate) fn energy(&self, at: &At<R>) -> R {
                let mut sum = R::splat(0.0);
                $(
                    if let Some(own) = &self.$field {
                        sum = sum + own.energy(at);
                    }
                )*
                sum
            }

            /// What is taken out.
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

/// A size that an effect has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Size {
    /// Its place among the sizes of all effects.
    pub(crate) index: usize,
    /// Where its effect enters.
    pub(crate) enters: Enters,
}

/// How many sizes all effects have.
pub(crate) const SIZES: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARED.len() {
        sum += DECLARED[k].sizes;
        k += 1;
    }
    sum
};

/// How many parameters all effects have.
pub(crate) const MOST_OF_EFFECTS: usize = {
    let (mut sum, mut k) = (0, 0);
    while k < DECLARED.len() {
        sum += DECLARED[k].parameters.len();
        k += 1;
    }
    sum
};

impl EffectKinds {
    /// Whether there is any.
    pub fn any(self) -> bool {
        self != Self::default()
    }

    /// The first of these that takes an elastic gear, by its name.
    pub fn of_gear(self) -> Option<&'static str> {
        let own = self.each().find(|(has, declared)| *has && declared.of_gear);
        own.map(|(_, declared)| declared.name)
    }

    /// The effects' parameters, and what size each is; none is a velocity or an exponent, say.
    pub(crate) fn parameters(self) -> Vec<(Parameter, Option<Size>)> {
        let (mut all, mut index) = (Vec::new(), 0);
        for (has, declared) in self.each() {
            for (place, &parameter) in declared.parameters.iter().enumerate() {
                let size = (place < declared.sizes).then_some(Size {
                    index: index + place,
                    enters: declared.enters,
                });
                if has {
                    all.push((parameter, size));
                }
            }
            index += declared.sizes;
        }
        all
    }
}
