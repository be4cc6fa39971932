//! A stiffness that increases with the square of the torsion: T = k_G delta + k_3 delta^3.

use super::{GearLaw, Law, MAX_LAW_PARAMETERS, Spring};
use crate::parameter::{Parameter, STIFFNESS};
use crate::scalar::Real;

/// The cubic law: the first two terms of the series of any odd smooth law (Tuttle and Seering, IEEE
/// Transactions on Robotics and Automation 12(3), 1996).
#[derive(Clone, Copy, Debug)]
pub struct Cubic;

/// A gear of the cubic law.
#[derive(Clone, Copy, Debug)]
pub struct CubicSpring<R> {
    stiffness: R,
    cubic: R,
}

impl GearLaw for Cubic {
    const LAW: Law = Law {
        name: "cubic",
        parameters: &[
            Parameter::positive("gear_stiffness", "k_G", STIFFNESS)
                .meaning("stiffness of the gear, at the link"),
            Parameter::non_negative("gear_stiffness_cubic", "k_3", ["N m/rad^3", "N/m^3"])
                .meaning("torque of the gear per cube of its torsion, at the link"),
        ],
        rising: &[],
        elastic: true,
    };
    type Spring<R: Real> = CubicSpring<R>;

    fn spring<R: Real>(values: &[R; MAX_LAW_PARAMETERS], _: f64) -> CubicSpring<R> {
        CubicSpring {
            stiffness: values[0],
            cubic: values[1],
        }
    }
}

impl<R: Real> Spring<R> for CubicSpring<R> {
    type Shared = ();

    #[inline(always)]
    fn torque(&self, delta: R) -> R {
        (self.cubic * delta * delta).mul_add(delta, self.stiffness * delta)
    }

    #[inline(always)]
    fn stiffness(&self, delta: R) -> R {
        (self.cubic * 3.0 * delta).mul_add(delta, self.stiffness)
    }

    #[inline(always)]
    fn energy(&self, delta: R) -> R {
        let square = delta * delta;
        let half = self.stiffness * 0.5;
        (self.cubic * 0.25).mul_add(square, half) * square
    }

    fn least_stiffness(&self, _: R) -> R {
        self.stiffness
    }

    fn shared(&self) {}

    #[inline(always)]
    fn by_parameters(&self, delta: R, (): &()) -> [R; MAX_LAW_PARAMETERS] {
        let mut by = [R::splat(0.0); MAX_LAW_PARAMETERS];
        by[0] = delta;
        by[1] = delta * delta * delta;
        by
    }
}
