//! Coulomb friction that increases with the torque of the gear.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{NO_UNIT, Parameter};
use crate::scalar::Real;

/// Friction of the teeth: adds mu |T| to the friction limit, with the gear torque T at the motor.
///
/// It requires Coulomb friction of the motor.
#[derive(Clone, Copy, Debug)]
pub struct LoadFriction<R> {
    /// mu.
    pub share: R,
}

impl<R: Real> Effect<R> for LoadFriction<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "load-friction",
        parameters: &[Parameter::non_negative("load_friction", "mu", NO_UNIT)
            .meaning("dry friction per torque through the gear, both at the motor")],
        sizes: 1,
        of_gear: true,
        affects: AffectedTerms {
            friction: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self { share: values[0] }
    }

    #[inline(always)]
    fn dry_friction(&self, _: R, load: R) -> R {
        self.share * load.abs()
    }
}
