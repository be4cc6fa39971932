//! Compliant base of a joint.

use super::{
    AffectedTerms, BaseTorque, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS,
    NO_TERMS,
};
use crate::parameter::{COMPLIANCE, FREQUENCY, NO_UNIT, Parameter};
use crate::scalar::Real;
use std::f64::consts::TAU;

/// The base turns about the joint's axis by phi = c s on a spring of compliance c. Its torque s
/// obeys dds = -w (2 zeta ds + w (s + tau)) under the gear torque tau; without load the base has
/// the natural frequency f, w = 2 pi f, and the damping ratio zeta.
#[derive(Clone, Copy, Debug)]
pub struct SoftBase<R> {
    /// c [rad/(N m)].
    pub compliance: R,
    /// w [rad/s].
    pub rate: R,
    /// zeta.
    pub damping: R,
}

impl<R: Real> Effect<R> for SoftBase<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "soft-base",
        parameters: &[
            Parameter::non_negative("base_compliance", "c_B", COMPLIANCE)
                .meaning("compliance of the base about the joint's axis"),
            Parameter::positive("base_frequency", "f_B", FREQUENCY)
                .meaning("natural frequency of the base without its link"),
            Parameter::positive("base_damping", "zeta_B", NO_UNIT)
                .meaning("damping ratio of the base without its link"),
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
            compliance: values[0],
            rate: values[1] * TAU,
            damping: values[2],
        }
    }

    /// -w (2 zeta ds + w (s + tau)).
    #[inline(always)]
    fn base_acceleration(&self, base: &BaseTorque<R>, gear: R) -> R {
        let damped = (self.damping + self.damping) * base.rate;
        -self.rate * self.rate.mul_add(base.torque + gear, damped)
    }

    #[inline(always)]
    fn base_rotation(&self, torque: R) -> R {
        self.compliance * torque
    }

    /// c (s^2 + (ds / w)^2) / 2: the inertia is 1 / (c w^2).
    fn energy(&self, at: &JointState<R>) -> R {
        let moving = at.base.rate / self.rate;
        let both = at.base.torque * at.base.torque + moving * moving;
        self.compliance * 0.5 * both
    }

    /// 2 c zeta ds^2 / w.
    fn loss(&self, at: &JointState<R>) -> R {
        let damping = (self.compliance + self.compliance) * self.damping / self.rate;
        damping * at.base.rate * at.base.rate
    }
}
