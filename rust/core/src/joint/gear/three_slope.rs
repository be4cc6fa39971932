//! Three stiffnesses and two knees, as in catalogues of strain-wave gears.

use super::{GearLaw, Law, MAX_LAW_PARAMETERS, Spring};
use crate::parameter::{Parameter, STIFFNESS, TORQUE};
use crate::scalar::Real;

/// Half width [rad] of the rounded knees of three-slope springs.
///
/// A parabola over +-w differs from the sharp knee by at most `(K2 - K1) w / 4`: 0.01 N m for the
/// stiffest knee of a size 20 gear, one four-hundredth of its first knee's torque.
pub const CORNER: f64 = 5e-6;

/// The elastic law T(delta) of Fig. 2: slope K1 up to the torque T1, K2 up to T2, K3 beyond; odd in
/// delta.
#[derive(Clone, Copy, Debug)]
pub struct ThreeSlope;

/// A three-slope gear.
#[derive(Clone, Copy, Debug)]
pub struct ThreeSlopeSpring<R> {
    k1: R,
    knees: [Knee<R>; 2],
}

/// Torsion of a knee, and the change of slope there.
#[derive(Clone, Copy, Debug)]
struct Knee<R> {
    shift: R,        // w - d: moves the beginning of the rounded corner to zero
    width: R,        // 2 w
    half_rise: R,    // (slope change) / (4 w)
    slope_change: R, // K_{j+1} - K_j
    per_width: R,    // 1 / (4 w)
}

/// 1/K1 and 1/K2, and derivatives of the knees' torsions with respect to K1 and K2.
#[derive(Clone, Copy, Debug)]
pub struct PerSlope<R> {
    k1: R,
    k2: R,
    first_knee_by_k1: R,
    second_knee_by_k2: R,
}

impl GearLaw for ThreeSlope {
    const LAW: Law = Law {
        name: "three-slope",
        parameters: &[
            Parameter::positive("gear_stiffness_k1", "K1", STIFFNESS)
                .meaning("stiffness of the gear below its first knee, at the link"),
            Parameter::positive("gear_stiffness_k2", "K2", STIFFNESS)
                .meaning("stiffness of the gear between its knees, at the link"),
            Parameter::positive("gear_stiffness_k3", "K3", STIFFNESS)
                .meaning("stiffness of the gear beyond its second knee, at the link"),
            Parameter::positive("gear_knee_t1", "T1", TORQUE)
                .meaning("gear torque at the first knee, at the link"),
            Parameter::positive("gear_knee_t2", "T2", TORQUE)
                .meaning("gear torque at the second knee, at the link"),
        ],
        rising: &[4],
        elastic: true,
    };
    type Spring<R: Real> = ThreeSlopeSpring<R>;

    #[inline(always)]
    fn spring<R: Real>(values: &[R; MAX_LAW_PARAMETERS], corner: f64) -> ThreeSlopeSpring<R> {
        let slopes = [values[0], values[1], values[2]];
        let knee_torques = [values[3], values[4]];
        let first = knee_torques[0] / slopes[0];
        let second = first + (knee_torques[1] - knee_torques[0]) / slopes[1];
        let knee = |at: R, change: R| Knee {
            shift: -at + corner,
            width: R::splat(2.0 * corner),
            half_rise: change * (0.25 / corner),
            slope_change: change,
            per_width: R::splat(0.25 / corner),
        };
        ThreeSlopeSpring {
            k1: slopes[0],
            knees: [
                knee(first, slopes[1] - slopes[0]),
                knee(second, slopes[2] - slopes[1]),
            ],
        }
    }
}

impl<R: Real> Spring<R> for ThreeSlopeSpring<R> {
    type Shared = PerSlope<R>;

    #[inline(always)]
    fn torque(&self, delta: R) -> R {
        let torsion = delta.abs();
        let mut torque = self.k1 * torsion;
        for knee in &self.knees {
            torque = knee.add_to(torque, torsion);
        }
        torque.copysign(delta)
    }

    #[inline(always)]
    fn energy(&self, delta: R) -> R {
        let torsion = delta.abs();
        let mut energy = self.k1 * 0.5 * torsion * torsion;
        for knee in &self.knees {
            energy = energy + knee.energy(torsion);
        }
        energy
    }

    #[inline(always)]
    fn stiffness(&self, delta: R) -> R {
        let torsion = delta.abs();
        let mut slope = self.k1;
        for knee in &self.knees {
            slope = slope + knee.slope(torsion);
        }
        slope
    }

    #[inline(always)]
    fn by_parameters(&self, delta: R, per: &PerSlope<R>) -> [R; MAX_LAW_PARAMETERS] {
        let zero = R::splat(0.0);
        let one = R::splat(1.0).copysign(delta);
        let torsion = delta.abs();
        let (first, second) = (self.knees[0].ramp(torsion), self.knees[1].ramp(torsion));
        // derivative of the torque with respect to a knee's torsion
        let two_out = one * self.knees[1].slope(torsion);
        let both_out = one.mul_add(self.knees[0].slope(torsion), two_out);
        let k1 = one.mul_add(torsion - first, both_out * per.first_knee_by_k1);
        let k2 = one.mul_add(first - second, two_out * per.second_knee_by_k2);
        let t1 = two_out.mul_add(per.k2, -(both_out * per.k1));
        [k1, k2, one * second, t1, -(two_out * per.k2), zero, zero]
    }

    #[inline(always)]
    fn shared(&self) -> PerSlope<R> {
        let one = R::splat(1.0);
        let k2 = one / (self.k1 + self.knees[0].slope_change);
        let at = |knee: &Knee<R>| knee.width * 0.5 - knee.shift;
        let (first, second) = (at(&self.knees[0]), at(&self.knees[1]));
        PerSlope {
            k1: one / self.k1,
            k2,
            first_knee_by_k1: first / self.k1,
            second_knee_by_k2: (second - first) * k2,
        }
    }

    fn least_stiffness(&self, _: R) -> R {
        let second = self.k1 + self.knees[0].slope_change;
        self.k1.min(second).min(second + self.knees[1].slope_change)
    }
}

impl<R: Real> Knee<R> {
    /// Adds `change * ramp(torsion - d)`: zero before the knee, a parabola within it, linear
    /// beyond.
    #[inline(always)]
    fn add_to(&self, torque: R, torsion: R) -> R {
        let into = (torsion + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        let torque = (self.half_rise * inside).mul_add(inside, torque);
        self.slope_change.mul_add(into - inside, torque)
    }

    /// Derivative of `add_to` with respect to the change of slope.
    #[inline(always)]
    fn ramp(&self, torsion: R) -> R {
        let into = (torsion + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        (self.per_width * inside).mul_add(inside, into - inside)
    }

    /// Derivative of `add_to` with respect to the torsion.
    #[inline(always)]
    fn slope(&self, torsion: R) -> R {
        let inside = (torsion + self.shift).max(R::splat(0.0)).min(self.width);
        self.half_rise * 2.0 * inside
    }

    /// Integral of `add_to` from zero torsion.
    #[inline(always)]
    fn energy(&self, torsion: R) -> R {
        let into = (torsion + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        let beyond = into - inside;
        let corner = self.half_rise * inside * inside;
        let third = R::splat(1.0 / 3.0);
        let half = R::splat(0.5);
        corner * inside * third + beyond * (corner + half * self.slope_change * beyond)
    }
}

#[cfg(test)]
mod tests;
