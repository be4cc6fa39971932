//! Gravity that the arm's model does not include.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS,
};
use crate::parameter::{Parameter, TORQUE};
use crate::scalar::Real;

/// The link has the potential energy -s cos a + c sin a at its angle in space a: a horizontal arm
/// on a tilted table, or an error in gravity's direction.
#[derive(Clone, Copy, Debug)]
pub struct Tilt<R> {
    /// s [N m].
    pub sin: R,
    /// c [N m].
    pub cos: R,
}

impl<R: Real> Effect<R> for Tilt<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "tilt",
        parameters: &[
            Parameter::any("tilt_sin", "s_t", TORQUE)
                .meaning("unknown gravity torque of the link at a quarter turn in space"),
            Parameter::any("tilt_cos", "c_t", TORQUE)
                .meaning("unknown gravity torque of the link at its zero in space"),
        ],
        sizes: 2,
        of_gear: false,
        affects: AffectedTerms {
            weight: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            sin: values[0],
            cos: values[1],
        }
    }

    #[inline(always)]
    fn weight(&self, angle: R) -> R {
        let (sin, cos) = angle.sin_cos();
        self.sin.mul_add(sin, self.cos * cos)
    }

    fn energy(&self, at: &JointState<R>) -> R {
        let (sin, cos) = at.angle_in_space.sin_cos();
        self.cos * sin - self.sin * cos
    }
}
