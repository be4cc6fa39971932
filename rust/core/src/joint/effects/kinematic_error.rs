//! A gear whose ratio changes as the wave generator turns.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{ANGLE, Parameter, Sign};
use crate::scalar::Real;

/// The link's angle is off by e = a cos(2 theta_M) + b sin(2 theta_M): the wave generator has two
/// lobes, and no gear is round.
#[derive(Clone, Copy, Debug)]
pub struct KinematicError<R> {
    /// a [rad] at the link.
    pub cos: R,
    /// b [rad] at the link.
    pub sin: R,
}

impl<R: Real> KinematicError<R> {
    /// e(theta_M) [rad] and its derivative e'(theta_M).
    #[inline(always)]
    pub fn at(&self, motor_angle: R) -> [R; 2] {
        let (sin, cos) = (motor_angle + motor_angle).sin_cos();
        let error = self.cos.mul_add(cos, self.sin * sin);
        let half_slope = self.sin * cos - self.cos * sin;
        [error, half_slope + half_slope]
    }
}

impl<R: Real> Effect<R> for KinematicError<R> {
    const DECLARED: Declared = Declared {
        name: "kinematic-error",
        parameters: &[
            Parameter::new(
                "kinematic_error_cos",
                "a",
                "cosine part of the gear's kinematic error, at the link",
                ANGLE,
                Sign::Any,
            ),
            Parameter::new(
                "kinematic_error_sin",
                "b",
                "sine part of the gear's kinematic error, at the link",
                ANGLE,
                Sign::Any,
            ),
        ],
        sizes: 2,
        of_gear: true,
        enters: Enters {
            gear: true,
            motor: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self {
            cos: values[0],
            sin: values[1],
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
        fn the_error_has_its_slope(theta in -50.0..50.0f64, cos in -2e-4..2e-4f64, sin in -2e-4..2e-4f64) {
            let error = KinematicError { cos, sin };
            let h = 1e-4;
            let slope = (error.at(theta + h)[0] - error.at(theta - h)[0]) / (2.0 * h);
            // of a sine of 2 theta: h^2 / 6 of its third derivative, eightfold
            prop_assert!((error.at(theta)[1] - slope).abs() < 1e-11);
            prop_assert!((error.at(theta + std::f64::consts::PI)[0] - error.at(theta)[0]).abs() < 1e-17);
        }
    }
}
