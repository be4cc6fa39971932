//! Drive train of one joint: friction of its motor, and its gear.

use crate::joint::effects::{Effects, Torsion};
use crate::joint::gear::{Gears, Spring};
use crate::parameter::{DAMPING, INERTIA, Parameter, TIME, TORQUE};
use crate::scalar::Real;

/// Parameters of motor and bearings, in the order of a flat list of values.
pub(crate) const DRIVE: [Parameter; 5] = [
    Parameter::positive("motor_inertia", "m_M", INERTIA)
        .meaning("inertia of motor and wave generator, at the motor"),
    Parameter::non_negative("motor_viscous_friction", "d_M", DAMPING)
        .meaning("viscous friction of the motor, at the motor"),
    Parameter::non_negative("motor_coulomb_friction", "f_M", TORQUE)
        .meaning("Coulomb friction of the motor, at the motor"),
    Parameter::any("friction_offset", "f_0", TORQUE)
        .meaning("constant part of the friction, at the motor"),
    Parameter::non_negative("link_viscous_friction", "d_L", DAMPING)
        .meaning("viscous friction of the link, at the link"),
];

/// Damping parallel to the spring of an elastic gear.
pub(crate) const GEAR_DAMPING: Parameter = Parameter::non_negative("gear_damping", "d_G", DAMPING)
    .meaning("damping of the gear, at the link");

/// Settling time of friction; for motors of elastic gears.
pub(crate) const SETTLING: Parameter =
    Parameter::non_negative("friction_settling_time", "tau", TIME)
        .meaning("time constant in which friction brings the motor to rest");

/// Drive train of one joint.
#[derive(Clone, Copy)]
pub struct Joint<R: Real, G: Gears> {
    /// n, link turns per motor turn.
    pub ratio: R,
    /// m_M [kg m^2] at the motor.
    pub motor_inertia: R,
    /// 1/m_M. A division in the innermost loop would double the cost of its line.
    pub motor_mobility: R,
    /// d_M [N m s/rad] at the motor.
    pub motor_viscous: R,
    /// f_M [N m] at the motor.
    pub coulomb: R,
    /// tau [s]: time constant with which friction stops the motor; zero: instantly.
    pub settling_time: R,
    /// 1/tau, very large for an instant stop.
    pub settling_rate: R,
    /// f_0 [N m] at the motor.
    pub offset: R,
    /// d_L [N m s/rad] at the link.
    pub link_viscous: R,
    /// Whether the gear is rigid; spring and damping are then unused.
    pub rigid: bool,
    /// T(delta).
    pub spring: G::Spring<R>,
    /// d_G [N m s/rad].
    pub gear_damping: R,
    /// Effects.
    pub effects: Effects<R>,
}

/// Gears at one instant; zeros for rigid gears.
pub(crate) struct DriveTrains<R, const N: usize> {
    /// Torsions and their rates.
    pub(crate) torsion: [Torsion<R>; N],
    /// Local ratios n + e'(theta_M): torques at the motors per torque at the links.
    pub(crate) ratio: [R; N],
    /// Torques [N m] at the links.
    pub(crate) torque: [R; N],
}

impl<R: Real, const N: usize> DriveTrains<R, N> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        let zero = R::splat(0.0);
        let (angle, rate) = (zero, zero);
        Self {
            torsion: [Torsion { angle, rate }; N],
            ratio: [zero; N],
            torque: [zero; N],
        }
    }
}

impl<R: Real, G: Gears> Joint<R, G> {
    /// An entry beyond the joints of an arm: nothing moves it.
    pub(crate) fn unused(spring: G::Spring<R>) -> Self {
        let (zero, one) = (R::splat(0.0), R::splat(1.0));
        Self {
            ratio: one,
            motor_inertia: one,
            motor_mobility: one,
            motor_viscous: zero,
            coulomb: zero,
            settling_time: zero,
            settling_rate: zero,
            offset: zero,
            link_viscous: zero,
            rigid: false,
            spring,
            gear_damping: zero,
            effects: Effects::NONE,
        }
    }
}

/// `EFFECTS` states at compile time whether the joint may have effects on motor, gear or link.
impl<R: Real, G: Gears> Joint<R, G> {
    /// Friction limit [N m] at a motor velocity [rad/s] and a gear torque at the motor [N m]; the
    /// friction torque of a sliding motor.
    #[inline(always)]
    pub fn dry_friction<const EFFECTS: bool>(&self, velocity: R, load: R) -> R {
        if EFFECTS {
            self.coulomb + self.effects.dry_friction(velocity, load)
        } else {
            self.coulomb
        }
    }

    /// Effective voltage [V] for a commanded one.
    #[inline(always)]
    pub(crate) fn effective_voltage(&self, voltage: R) -> R {
        self.effects.drive(voltage)
    }

    /// Mean effective voltage [V] over a time [s] for a constant voltage; updates the state of the
    /// drive.
    #[inline(always)]
    pub(crate) fn hold_voltage(&self, voltage: R, memory: &mut R, time: f64) -> R {
        let [mean, end] = self.effects.hold_voltage(voltage, *memory, time);
        *memory = end;
        mean
    }

    /// T(delta) + d_G ddelta, with effects.
    #[inline(always)]
    pub(crate) fn transmitted<const EFFECTS: bool>(&self, torsion: &Torsion<R>, z: R) -> R {
        if EFFECTS {
            let elastic = self.spring.torque(self.effects.strain(torsion.angle));
            let torque = self.gear_damping.mul_add(torsion.rate, elastic);
            torque + self.effects.gear_torque(z)
        } else {
            self.gear_damping
                .mul_add(torsion.rate, self.spring.torque(torsion.angle))
        }
    }

    /// Torsion [rad] at rest at a gear torque [N m].
    pub(crate) fn torsion<const EFFECTS: bool>(&self, torque: R) -> R {
        let strain = self.spring.torsion(torque);
        if EFFECTS {
            self.effects.torsion(strain)
        } else {
            strain
        }
    }
}
