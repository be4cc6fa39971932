//! Stribeck friction.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign, TORQUE, VELOCITY};
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
    const DECLARED: Declared = Declared {
        name: "stribeck",
        parameters: &[
            Parameter::new(
                "stribeck_friction",
                "f_S",
                "excess of the friction at standstill over Coulomb friction",
                TORQUE,
                Sign::NonNegative,
            ),
            Parameter::new(
                "stribeck_velocity",
                "w_s",
                "motor velocity at which 1/e of the Stribeck friction is left",
                VELOCITY,
                Sign::Positive,
            ),
        ],
        sizes: 1,
        of_gear: false,
        enters: Enters {
            friction: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
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
    fn it_is_all_there_at_rest_and_gone_at_speed() {
        let law = Stribeck {
            friction: 0.02,
            velocity: 3.0,
        };
        assert_eq!(law.at(0.0), 0.02);
        assert!((law.at(-3.0) - 0.02 * (-1.0f64).exp()).abs() < 1e-17);
        assert!(law.at(30.0) < 1e-40);
    }
}
