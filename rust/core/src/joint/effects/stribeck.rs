//! Stribeck friction.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{Parameter, TORQUE, VELOCITY};
use crate::scalar::Real;

/// Friction in excess of Coulomb friction that decreases with velocity: f_S exp(-(dtheta_M/w_s)^2).
#[derive(Clone, Copy, Debug)]
pub struct Stribeck<R> {
    /// f_S [N m] at the motor.
    pub friction: R,
    /// w_s [rad/s] of the motor.
    pub velocity: R,
}

impl<R: Real> Stribeck<R> {
    /// f_S exp(-(v/w_s)^2) [N m] at a motor velocity v [rad/s].
    #[inline(always)]
    pub fn at(&self, velocity: R) -> R {
        let share = velocity / self.velocity;
        self.friction * (-(share * share)).exp()
    }
}

impl<R: Real> Effect<R> for Stribeck<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "stribeck",
        parameters: &[
            Parameter::non_negative("stribeck_friction", "f_S", TORQUE)
                .meaning("excess of the friction at standstill over Coulomb friction"),
            Parameter::positive("stribeck_velocity", "w_s", VELOCITY)
                .meaning("motor velocity at which the Stribeck friction has decayed to 1/e"),
        ],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            friction: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            friction: values[0],
            velocity: values[1],
        }
    }

    #[inline(always)]
    fn dry_friction(&self, velocity: R, _: R) -> R {
        self.at(velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_decays_from_rest_to_high_velocity() {
        let law = Stribeck {
            friction: 0.02,
            velocity: 3.0,
        };
        assert_eq!(law.at(0.0), 0.02);
        assert!((law.at(-3.0) - 0.02 * (-1.0f64).exp()).abs() < 1e-17);
        assert!(law.at(30.0) < 1e-40);
    }
}
