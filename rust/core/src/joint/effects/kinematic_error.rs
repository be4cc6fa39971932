//! Kinematic error of a gear: its ratio varies with the angle of the wave generator.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{ANGLE, NO_UNIT, Parameter};
use crate::scalar::Real;

/// The link's angle has the error e = a cos(k theta_M) + b sin(k theta_M). The wave generator has
/// two lobes, so k = 2 is usual.
#[derive(Clone, Copy, Debug)]
pub struct KinematicError<R> {
    /// a [rad] at the link.
    pub cos: R,
    /// b [rad] at the link.
    pub sin: R,
    /// k, periods per turn of the motor.
    pub order: R,
}

impl<R: Real> KinematicError<R> {
    /// e(theta_M) [rad] and its derivative e'(theta_M).
    #[inline(always)]
    pub fn at(&self, motor_angle: R) -> [R; 2] {
        let (sin, cos) = (self.order * motor_angle).sin_cos();
        let error = self.cos.mul_add(cos, self.sin * sin);
        [error, self.order * (self.sin * cos - self.cos * sin)]
    }
}

impl<R: Real> Effect<R> for KinematicError<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "kinematic-error",
        parameters: &[
            Parameter::any("kinematic_error_cos", "a", ANGLE)
                .meaning("cosine part of the gear's kinematic error, at the link"),
            Parameter::any("kinematic_error_sin", "b", ANGLE)
                .meaning("sine part of the gear's kinematic error, at the link"),
            Parameter::positive("kinematic_error_order", "k_e", NO_UNIT)
                .meaning("periods of the gear's kinematic error in a turn of the motor"),
        ],
        sizes: 2,
        of_gear: true,
        affects: AffectedTerms {
            gear: true,
            output: true,
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
    fn error(&self, motor_angle: R) -> [R; 2] {
        self.at(motor_angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn error_slope_matches_differences(
            theta in -50.0..50.0f64, cos in -2e-4..2e-4f64, sin in -2e-4..2e-4f64, k in 1..=6u8
        ) {
            let order = f64::from(k);
            let error = KinematicError { cos, sin, order };
            let h = 1e-4;
            let slope = (error.at(theta + h)[0] - error.at(theta - h)[0]) / (2.0 * h);
            // of a sine of k theta: h^2 / 6 of its third derivative, which is proportional to k^3
            let off = 6.0 * 2e-4 * order.powi(3) * h * h / 6.0;
            prop_assert!((error.at(theta)[1] - slope).abs() < off + 1e-11);
            let turn = std::f64::consts::TAU / order;
            prop_assert!((error.at(theta + turn)[0] - error.at(theta)[0]).abs() < 1e-16);
        }
    }
}
