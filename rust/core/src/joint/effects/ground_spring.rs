//! Spring between link and ground, such as a bundle of cables.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS,
};
use crate::parameter::{Parameter, STIFFNESS, TORQUE};
use crate::scalar::Real;

/// The load on the link is c theta_L + t.
#[derive(Clone, Copy, Debug)]
pub struct GroundSpring<R> {
    /// c [N m/rad].
    pub stiffness: R,
    /// t [N m].
    pub preload: R,
}

impl<R: Real> Effect<R> for GroundSpring<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "ground-spring",
        parameters: &[
            Parameter::non_negative("ground_stiffness", "c_g", STIFFNESS)
                .meaning("stiffness of cables between the link and ground, by the joint's angle"),
            Parameter::any("ground_preload", "t_g", TORQUE)
                .meaning("torque of cables between the link and ground at the joint's zero"),
        ],
        sizes: 2,
        of_gear: false,
        affects: AffectedTerms {
            link: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            stiffness: values[0],
            preload: values[1],
        }
    }

    #[inline(always)]
    fn load(&self, angle: R) -> R {
        self.stiffness.mul_add(angle, self.preload)
    }

    fn energy(&self, at: &JointState<R>) -> R {
        (self.stiffness * 0.5 * at.link_angle + self.preload) * at.link_angle
    }
}
