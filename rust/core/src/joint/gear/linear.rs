//! One stiffness: T = k_G delta.

use super::{GearLaw, Law, MAX_LAW_PARAMETERS, Spring};
use crate::parameter::{Parameter, STIFFNESS};
use crate::scalar::Real;

/// The linear law, (2).
#[derive(Clone, Copy, Debug)]
pub struct Linear;

/// A linear gear.
#[derive(Clone, Copy, Debug)]
pub struct LinearSpring<R> {
    stiffness: R,
}

impl GearLaw for Linear {
    const LAW: Law = Law {
        name: "linear",
        parameters: &[Parameter::positive("gear_stiffness", "k_G", STIFFNESS)
            .meaning("stiffness of the gear, at the link")],
        rising: &[],
        elastic: true,
    };
    type Spring<R: Real> = LinearSpring<R>;

    fn spring<R: Real>(values: &[R; MAX_LAW_PARAMETERS], _: f64) -> LinearSpring<R> {
        LinearSpring {
            stiffness: values[0],
        }
    }
}

impl<R: Real> Spring<R> for LinearSpring<R> {
    type Shared = ();

    #[inline(always)]
    fn torque(&self, delta: R) -> R {
        self.stiffness * delta
    }

    #[inline(always)]
    fn stiffness(&self, _: R) -> R {
        self.stiffness
    }

    #[inline(always)]
    fn energy(&self, delta: R) -> R {
        self.stiffness * 0.5 * delta * delta
    }

    fn least_stiffness(&self, _: R) -> R {
        self.stiffness
    }

    fn shared(&self) {}

    #[inline(always)]
    fn by_parameters(&self, delta: R, (): &()) -> [R; MAX_LAW_PARAMETERS] {
        let mut by = [R::splat(0.0); MAX_LAW_PARAMETERS];
        by[0] = delta;
        by
    }
}
