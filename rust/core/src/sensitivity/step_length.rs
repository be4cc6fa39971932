//! Derivatives of the end of a step with respect to its length.
//!
//! The stages of a step move with its length at rates that the trace of the step determines.
//! The rest follows from the variational equations.

use crate::arm::Arm;
use crate::arm::transmission::link_of;
use crate::joint::gear::Gears;
use crate::scalar::{Lanes, Real};
use crate::sensitivity::tangent::Tangent;
use crate::sensitivity::trace::{Stages, Trace};
use crate::sensitivity::variational::LinearisedStep;

/// Derivatives of the stages and of the end of a step with respect to its length, for fixed
/// accelerations.
pub(crate) struct StepLengthSensitivity<S, const N: usize> {
    /// The second to the fourth stage.
    pub(crate) stages: [Tangent<S, N>; 3],
    pub(crate) end: Tangent<S, N>,
    /// Motor torques at the middle and at the end.
    pub(crate) torque: [[S; N]; 2],
}

impl<S: Real, const N: usize> StepLengthSensitivity<S, N> {
    /// Derivatives for a step of length `h` with its trace.
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, L: Lanes, G: Gears>(
        trace: &Trace<A, N>,
        step: &LinearisedStep<A, L, G, N>,
        torque: [[S; N]; 2],
        h: f64,
    ) -> Self {
        let mut all = [Tangent::zero(); 4];
        let mut positions = [[0.0; N]; 4];
        for i in 0..N {
            let link = LengthDerivative::of(
                trace.each(|stage| stage.velocity[i]),
                trace.each(|stage| stage.link_acceleration[i]),
                h,
            );
            let velocity = trace.each(|stage| stage.motor_velocity[i]);
            let acceleration = trace.each(|stage| stage.motor_acceleration[i]);
            let motor = if step.settling[i].is_some() {
                LengthDerivative::settling(velocity, acceleration)
            } else {
                LengthDerivative::of(velocity, acceleration, h)
            };
            let n = trace.ratio[i];
            for k in 0..4 {
                let tangent = &mut all[k];
                positions[k][i] = motor.position[k];
                tangent.angle[i] = S::splat(link.position[k]);
                tangent.motor[i] = S::splat(step.half * n * motor.velocity[k]);
                tangent.link[i] = S::splat(step.half * link.velocity[k]);
            }
        }
        for (tangent, positions) in all.iter_mut().zip(&positions) {
            for i in 0..N {
                let driven = link_of(&step.plant.arm, i, &trace.ratio, positions, 0.0);
                tangent.torsion[i] = S::splat(driven - tangent.angle[i].lane(0));
            }
        }
        let [second, third, fourth, end] = all;
        Self {
            stages: [second, third, fourth],
            end,
            torque,
        }
    }
}

/// Derivatives of a position and its velocity with respect to the step length, at the second to the
/// fourth stage and at the end.
struct LengthDerivative {
    position: Stages,
    velocity: Stages,
}

impl LengthDerivative {
    /// From the velocities and accelerations at the stages.
    fn of(v: Stages, a: Stages, h: f64) -> Self {
        Self {
            position: [
                0.5 * v[0],
                0.5 * v[0] + 0.5 * h * a[0],
                v[0] + h * a[1],
                v[0] + h * (a[0] + a[1] + a[2]) / 3.0,
            ],
            velocity: [
                0.5 * a[0],
                0.5 * a[1],
                a[2],
                (a[0] + 2.0 * (a[1] + a[2]) + a[3]) / 6.0,
            ],
        }
    }

    /// Derivatives for a held motor, whose stages and end are those of settling.
    fn settling(v: Stages, a: Stages) -> Self {
        Self {
            position: [0.5 * v[1], 0.5 * v[2], v[3], v[3]],
            velocity: [0.5 * a[1], 0.5 * a[2], a[3], a[3]],
        }
    }
}
