//! A position loop around a PI velocity loop.

use super::pi_velocity::PiVelocityMemory;
use super::{Controller, PiVelocity};
use crate::arm::first_joints;
use crate::scalar::Real;

/// A proportional position loop around a PI velocity loop: e = reference + position_gain
/// (theta_M(0) + integral(reference) - encoder) - encoder difference / period.
///
/// The integral of the reference includes the current reading, so the loop follows the path that
/// the reference velocities describe.
#[derive(Clone, Copy, Debug)]
pub struct PiPosition<const N: usize> {
    /// Inner loop.
    pub velocity: PiVelocity<N>,
    /// Gain of the outer loop [1/s].
    pub position_gain: [f64; N],
}

/// State of a position loop.
#[derive(Clone, Copy, Debug)]
pub struct PiPositionMemory<R, const N: usize> {
    /// State of the inner loop.
    pub velocity: PiVelocityMemory<R, N>,
    /// theta_M(0) + integral(reference) [rad].
    pub path: [R; N],
}

impl<const N: usize> PiPosition<N> {
    /// The controller of the first joints.
    pub(crate) fn of_first_joints<const M: usize>(&self) -> PiPosition<M> {
        PiPosition {
            velocity: self.velocity.of_first_joints(),
            position_gain: first_joints(&self.position_gain),
        }
    }
}

impl<const N: usize> Controller<N> for PiPosition<N> {
    type Memory<R: Real> = PiPositionMemory<R, N>;

    fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> PiPositionMemory<R, N> {
        PiPositionMemory {
            velocity: self.velocity.at_rest(voltage, encoder),
            path: *encoder,
        }
    }

    /// `reference` holds motor velocities [rad/s].
    #[inline(always)]
    fn command<R: Real>(
        &self,
        memory: &mut PiPositionMemory<R, N>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        let mut corrected = reference.map(R::splat);
        for i in 0..N {
            let error = memory.path[i] - encoder[i];
            corrected[i] = corrected[i] + error * self.position_gain[i];
            memory.path[i] = memory.path[i] + reference[i] * self.velocity.period;
        }
        self.velocity
            .follow(&mut memory.velocity, &corrected, encoder, feed_forward)
    }

    fn drives(&self, joint: usize) -> bool {
        self.velocity.drives(joint)
    }
}
