//! Torque ripple of a motor.

use super::{
    AffectedTerms, Effect, EffectDeclaration, JointState, MAX_EFFECT_PARAMETERS, NO_TERMS,
};
use crate::parameter::{NO_UNIT, Parameter, TORQUE};
use crate::scalar::Real;

/// A torque a cos(k theta_M) + b sin(k theta_M), from cogging or commutation errors.
#[derive(Clone, Copy, Debug)]
pub struct TorqueRipple<R> {
    /// a [N m] at the motor.
    pub cos: R,
    /// b [N m] at the motor.
    pub sin: R,
    /// k, periods per turn of the motor.
    pub order: R,
}

impl<R: Real> Effect<R> for TorqueRipple<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "torque-ripple",
        parameters: &[
            Parameter::any("torque_ripple_cos", "a_r", TORQUE)
                .meaning("cosine part of the motor's torque ripple"),
            Parameter::any("torque_ripple_sin", "b_r", TORQUE)
                .meaning("sine part of the motor's torque ripple"),
            Parameter::positive("torque_ripple_order", "k_r", NO_UNIT)
                .meaning("periods of the torque ripple in a turn of the motor"),
        ],
        sizes: 2,
        of_gear: false,
        affects: AffectedTerms {
            motor: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            cos: values[0],
            sin: values[1],
            order: values[2],
        }
    }

    #[inline(always)]
    fn motor_torque(&self, angle: R, _: R) -> R {
        let (sin, cos) = (self.order * angle).sin_cos();
        self.cos.mul_add(cos, self.sin * sin)
    }

    fn energy(&self, at: &JointState<R>) -> R {
        let (sin, cos) = (self.order * at.motor_angle).sin_cos();
        (self.sin * cos - self.cos * sin) / self.order
    }
}
