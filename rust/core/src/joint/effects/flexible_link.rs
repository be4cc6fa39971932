//! Flexible part of a link.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS,
    PartDeflection,
};
use crate::parameter::{FREQUENCY, INERTIA, NO_UNIT, Parameter};
use crate::scalar::Real;
use std::f64::consts::TAU;

/// An inertia J on a spring and a damper on the link. With the link fixed its natural frequency is
/// f, w = 2 pi f, with the damping ratio zeta.
#[derive(Clone, Copy, Debug)]
pub struct FlexibleLink<R> {
    /// J [kg m^2].
    pub inertia: R,
    /// w [rad/s].
    pub rate: R,
    /// zeta.
    pub damping: R,
}

impl<R: Real> Effect<R> for FlexibleLink<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "flexible-link",
        parameters: &[
            Parameter::non_negative("flexible_inertia", "J_f", INERTIA)
                .meaning("inertia of the flexible part of the link"),
            Parameter::positive("flexible_frequency", "f_f", FREQUENCY)
                .meaning("natural frequency of the flexible part with the link fixed"),
            Parameter::positive("flexible_damping", "zeta_f", NO_UNIT)
                .meaning("damping ratio of the flexible part with the link fixed"),
        ],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            weight: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            inertia: values[0],
            rate: values[1] * TAU,
            damping: values[2],
        }
    }

    /// -w (2 zeta dx + w x).
    #[inline(always)]
    fn part_acceleration(&self, deflection: &PartDeflection<R>) -> R {
        let damped = (self.damping + self.damping) * deflection.rate;
        -self.rate * self.rate.mul_add(deflection.angle, damped)
    }

    #[inline(always)]
    fn part_load(&self, acceleration: R) -> R {
        self.inertia * acceleration
    }

    fn energy(&self, at: &JointState<R>) -> R {
        let strained = self.rate * at.deflection.angle;
        let moving = at.part_velocity * at.part_velocity;
        self.inertia * 0.5 * (strained * strained + moving)
    }

    /// 2 J zeta w dx^2.
    fn loss(&self, at: &JointState<R>) -> R {
        let damping = (self.inertia + self.inertia) * self.damping * self.rate;
        damping * at.deflection.rate * at.deflection.rate
    }
}
