//! Hysteresis of a gear.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS, Torsion,
};
use crate::parameter::{ANGLE, Parameter, TORQUE};
use crate::scalar::Real;

/// Dahl's element parallel to the gear's spring: the torque T_h z with dz/dt = (ddelta - |ddelta|
/// z) / delta_h.
///
/// The law is rate-independent and has a closed form between two reversals. It is evaluated, not
/// integrated: z stays within [-1, 1] for any `delta_h`, and a step without a reversal has a smooth
/// spring.
#[derive(Clone, Copy, Debug)]
pub struct Hysteresis<R> {
    /// T_h [N m] at the link.
    pub torque: R,
    /// delta_h [rad].
    pub reversal_torsion: R,
}

impl<R: Real> Hysteresis<R> {
    /// z after a torsion change `change` [rad] without reversal: s + (z - s) exp(-|change| /
    /// delta_h), with the sign s of the change.
    #[inline(always)]
    pub fn relax(&self, z: R, change: R) -> R {
        let limit = R::splat(1.0).copysign(change);
        (z - limit).mul_add((-(change.abs() / self.reversal_torsion)).exp(), limit)
    }

    /// z after a time [s] between two torsions, with one reversal if the torsion rate changes sign;
    /// for scalars of one lane.
    ///
    /// The reversal is that of the cubic through both ends with their rates. The torsion is
    /// stationary there, so no derivative of its time is needed.
    #[inline(always)]
    pub fn state_after(&self, z: R, from: &Torsion<R>, to: &Torsion<R>, time: R) -> R {
        let change = to.angle - from.angle;
        if from.rate.lane(0) * to.rate.lane(0) >= 0.0 {
            return self.relax(z, change);
        }
        let (begin, end) = (from.rate * time, to.rate * time);
        let square = change * 3.0 - begin - begin - end;
        let cube = begin + end - change - change;
        let at = R::splat(extremum(begin.lane(0), square.lane(0), cube.lane(0)));
        let first_change = cube.mul_add(at, square).mul_add(at, begin) * at;
        self.relax(self.relax(z, first_change), change - first_change)
    }

    /// Recoverable energy [J]: T_h delta_h z^2 / 2.
    #[inline(always)]
    pub fn stored_energy(&self, z: R) -> R {
        self.torque * 0.5 * self.reversal_torsion * z * z
    }
}

/// Extremum between 0 and 1 of `a s + b s^2 + c s^3`, whose slopes at the ends have opposite signs.
fn extremum(a: f64, b: f64, c: f64) -> f64 {
    let discriminant = (b * b - 3.0 * a * c).max(0.0);
    // form of the quadratic formula without cancellation in the common case b < 0
    (a / (discriminant.sqrt().copysign(a) - b)).clamp(0.0, 1.0)
}

impl<R: Real> Effect<R> for Hysteresis<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "hysteresis",
        parameters: &[
            Parameter::non_negative("hysteresis_torque", "T_h", TORQUE)
                .meaning("largest torque of the gear's hysteresis, at the link"),
            Parameter::positive("hysteresis_twist", "delta_h", ANGLE)
                .meaning("torsion in which the hysteresis reverses, at the link"),
        ],
        sizes: 1,
        of_gear: true,
        affects: AffectedTerms {
            gear: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            torque: values[0],
            reversal_torsion: values[1],
        }
    }

    #[inline(always)]
    fn gear_torque(&self, z: R) -> R {
        self.torque * z
    }

    #[inline(always)]
    fn hysteresis_after(&self, z: R, from: &Torsion<R>, to: &Torsion<R>, time: R) -> R {
        self.state_after(z, from, to, time)
    }

    fn energy(&self, at: &JointState<R>) -> R {
        self.stored_energy(at.z)
    }

    /// T_h |ddelta| z^2.
    fn loss(&self, at: &JointState<R>) -> R {
        self.torque * at.torsion.rate.abs() * at.z * at.z
    }
}

#[cfg(test)]
mod tests;
