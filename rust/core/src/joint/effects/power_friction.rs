//! Friction that increases with a power of the velocity, such as that of grease.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS,
};
use crate::parameter::{NO_UNIT, Parameter, TORQUE};
use crate::scalar::Real;

/// A torque f_P ((|dtheta_M|/w + s)^p - s^p) against the motion, with w = 100 rad/s and s = 0.01.
/// For p = 1/2 it approximates the square root of the velocity with a finite slope at rest.
#[derive(Clone, Copy, Debug)]
pub struct PowerFriction<R> {
    /// f_P [N m] at the motor, at about 100 rad/s.
    pub friction: R,
    /// p.
    pub exponent: R,
}

/// Velocity [rad/s] at which the friction is about f_P.
const REFERENCE_VELOCITY: f64 = 100.0;
/// Offset of the relative velocity, which keeps the slope at rest finite.
const RELATIVE_VELOCITY_OFFSET: f64 = 0.01;

impl<R: Real> PowerFriction<R> {
    /// The torque against a velocity [rad/s].
    #[inline(always)]
    fn at(&self, velocity: R) -> R {
        let speed = velocity.abs() * (1.0 / REFERENCE_VELOCITY) + RELATIVE_VELOCITY_OFFSET;
        let power = |base: R| (self.exponent * base.ln()).exp();
        (self.friction * (power(speed) - power(R::splat(RELATIVE_VELOCITY_OFFSET))))
            .copysign(velocity)
    }
}

impl<R: Real> Effect<R> for PowerFriction<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "power-friction",
        parameters: &[
            Parameter::non_negative("power_friction", "f_P", TORQUE)
                .meaning("friction at 100 rad/s that grows with a power of the motor's velocity"),
            Parameter::positive("power_exponent", "p", NO_UNIT)
                .meaning("power of the velocity with which friction grows"),
        ],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            motor: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            friction: values[0],
            exponent: values[1],
        }
    }

    #[inline(always)]
    fn motor_torque(&self, _: R, velocity: R) -> R {
        -self.at(velocity)
    }

    fn loss(&self, at: &JointState<R>) -> R {
        self.at(at.motor_velocity) * at.motor_velocity
    }
}
