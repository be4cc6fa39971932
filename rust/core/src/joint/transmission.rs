//! One joint's drive train, and what its motor's friction and its gear do at one instant.

use crate::joint::effects::{Effects, Twist};
use crate::joint::gear::{Gears, Spring};
use crate::parameter::{DAMPING, INERTIA, Parameter, Sign, TIME, TORQUE};
use crate::scalar::Real;

/// Parameters of motor and bearings, in the order of a flat list of values.
pub(crate) const DRIVE: [Parameter; 5] = [
    Parameter::new(
        "motor_inertia",
        "m_M",
        "inertia of motor and wave generator, at the motor",
        INERTIA,
        Sign::Positive,
    ),
    Parameter::new(
        "motor_viscous_friction",
        "d_M",
        "viscous friction of the motor, at the motor",
        DAMPING,
        Sign::NonNegative,
    ),
    Parameter::new(
        "motor_coulomb_friction",
        "f_M",
        "Coulomb friction of the motor, at the motor",
        TORQUE,
        Sign::NonNegative,
    ),
    Parameter::new(
        "friction_offset",
        "f_0",
        "constant part of the friction, at the motor",
        TORQUE,
        Sign::Any,
    ),
    Parameter::new(
        "link_viscous_friction",
        "d_L",
        "viscous friction of the link, at the link",
        DAMPING,
        Sign::NonNegative,
    ),
];

/// Damping beside an elastic gear's spring.
pub(crate) const GEAR_DAMPING: Parameter = Parameter::new(
    "gear_damping",
    "d_G",
    "damping of the gear, at the link",
    DAMPING,
    Sign::NonNegative,
);

/// How fast friction brings a motor to rest; an elastic gear's motor alone has it.
pub(crate) const SETTLING: Parameter = Parameter::new(
    "friction_settling_time",
    "tau",
    "time constant in which friction brings the motor to rest",
    TIME,
    Sign::NonNegative,
);

/// One joint's drive train.
#[derive(Clone, Copy)]
pub struct Joint<R: Real, G: Gears> {
    /// n, link turns per motor turn.
    pub ratio: R,
    /// m_M [kg m^2] at the motor.
    pub motor_inertia: R,
    /// 1/m_M: a division in the innermost loop would cost as much as all else in its line.
    pub motor_mobility: R,
    /// d_M [N m s/rad] at the motor.
    pub motor_viscous: R,
    /// f_M [N m] at the motor.
    pub coulomb: R,
    /// tau [s]: how fast a motor that friction stops comes to rest; zero: at once.
    pub settling_time: R,
    /// 1/tau, huge where it stops at once.
    pub settling_rate: R,
    /// f_0 [N m] at the motor.
    pub offset: R,
    /// d_L [N m s/rad] at the link.
    pub link_viscous: R,
    /// Whether the gear is rigid; its spring and damping then mean nothing.
    pub rigid: bool,
    /// T(delta).
    pub spring: G::Spring<R>,
    /// d_G [N m s/rad].
    pub gear_damping: R,
    /// What it has beyond these.
    pub effects: Effects<R>,
}

/// One gear at one instant.
pub(crate) struct Gear<R> {
    /// How far it is twisted.
    pub(crate) twist: Twist<R>,
    /// Link turns per motor turn just there: torque at the motor per torque at the link.
    pub(crate) lever: R,
}

/// `EFFECTS` says at compile time whether the joint may have any.
impl<R: Real, G: Gears> Joint<R, G> {
    /// What dry friction can take up at most [N m] at a velocity of the motor [rad/s] and a torque of
    /// the gear at the motor [N m], and does take up while the motor slides.
    #[inline(always)]
    pub fn dry_friction<const EFFECTS: bool>(&self, velocity: R, load: R) -> R {
        if EFFECTS {
            self.coulomb + self.effects.dry_friction(velocity, load)
        } else {
            self.coulomb
        }
    }

    /// What the drive makes of a voltage [V] that is commanded.
    #[inline(always)]
    pub(crate) fn driven<const EFFECTS: bool>(&self, voltage: R) -> R {
        if EFFECTS {
            self.effects.drive(voltage)
        } else {
            voltage
        }
    }

    /// What acts on the mean of a driven voltage [V] that is held for a time [s], where the drive
    /// remembers another; it remembers the new one.
    #[inline(always)]
    pub(crate) fn held<const EFFECTS: bool>(&self, driven: R, memory: &mut R, time: f64) -> R {
        if EFFECTS {
            let [mean, end] = self.effects.held(driven, *memory, time);
            *memory = end;
            mean
        } else {
            driven
        }
    }

    /// Link angle [rad] at which an elastic gear is not twisted: n theta_M + e(theta_M).
    pub fn untwisted<const EFFECTS: bool>(&self, motor_angle: R) -> R {
        let angle = self.ratio * motor_angle;
        if EFFECTS {
            angle + self.effects.error(motor_angle)[0]
        } else {
            angle
        }
    }

    /// delta = n theta_M + e(theta_M) - theta_L, its rate, and n + e'(theta_M), from the angles and
    /// the velocities of motor and link.
    #[inline(always)]
    pub(crate) fn gear<const EFFECTS: bool>(
        &self,
        [motor_angle, link_angle]: [R; 2],
        [motor_velocity, link_velocity]: [R; 2],
    ) -> Gear<R> {
        let mut lever = self.ratio;
        let mut angle = lever.mul_add(motor_angle, -link_angle);
        if EFFECTS {
            let [off, slope] = self.effects.error(motor_angle);
            (angle, lever) = (angle + off, lever + slope);
        }
        let rate = lever.mul_add(motor_velocity, -link_velocity);
        Gear {
            twist: Twist { angle, rate },
            lever,
        }
    }

    /// T(delta) + d_G ddelta, and what effects add to it.
    #[inline(always)]
    pub(crate) fn transmitted<const EFFECTS: bool>(&self, twist: &Twist<R>, z: R) -> R {
        if EFFECTS {
            let sprung = self.spring.torque(self.effects.strain(twist.angle));
            let torque = self.gear_damping.mul_add(twist.rate, sprung);
            torque + self.effects.gear_torque(z)
        } else {
            self.gear_damping
                .mul_add(twist.rate, self.spring.torque(twist.angle))
        }
    }

    /// The torsion [rad] at which the gear passes a torque [N m] at rest.
    pub(crate) fn torsion<const EFFECTS: bool>(&self, torque: R) -> R {
        let strain = self.spring.torsion(torque);
        if EFFECTS {
            self.effects.torsion(strain)
        } else {
            strain
        }
    }
}
