//! Coulomb friction that increases with the torque of the gear.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign};
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
    const DECLARED: Declared = Declared {
        name: "load-friction",
        parameters: &[Parameter::new(
            "load_friction",
            "mu",
            "dry friction per torque through the gear, both at the motor",
            ["1", "1"],
            Sign::NonNegative,
        )],
        sizes: 1,
        of_gear: true,
        enters: Enters {
            friction: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self { share: values[0] }
    }

    #[inline(always)]
    fn dry_friction(&self, _: R, load: R) -> R {
        self.share * load.abs()
    }
}
