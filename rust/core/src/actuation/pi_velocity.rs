//! A PI velocity loop.

use super::Controller;
use crate::arm::first_joints;
use crate::scalar::Real;

/// A PI velocity loop on encoder differences for each joint: u = kp e + ki integral(e) +
/// feed-forward, limited, with e = reference - encoder difference / period.
///
/// The integral includes the error of the current reading (backward Euler).
#[derive(Clone, Copy, Debug)]
pub struct PiVelocity<const N: usize> {
    /// kp [V s/rad].
    pub kp: [f64; N],
    /// ki [V/rad].
    pub ki: [f64; N],
    /// Largest voltage [V]; integration stops while the output is limited.
    pub limit: f64,
    /// Time between two readings [s].
    pub period: f64,
    /// Joints under control.
    pub active: [bool; N],
}

/// State of a PI velocity loop.
#[derive(Clone, Copy, Debug)]
pub struct PiVelocityMemory<R, const N: usize> {
    /// Integral of the velocity error [rad].
    pub integral: [R; N],
    /// Last reading of the encoder [rad].
    pub last_angle: [R; N],
}

impl<const N: usize> PiVelocity<N> {
    /// The controller of the first joints.
    pub(crate) fn of_first_joints<const M: usize>(&self) -> PiVelocity<M> {
        PiVelocity {
            kp: first_joints(&self.kp),
            ki: first_joints(&self.ki),
            limit: self.limit,
            period: self.period,
            active: first_joints(&self.active),
        }
    }

    /// The loop with a reference [rad/s] that may depend on the motion.
    pub(super) fn follow<R: Real>(
        &self,
        memory: &mut PiVelocityMemory<R, N>,
        reference: &[R; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        const { assert!(R::LANES == 1) };
        let c = R::splat;
        let mut voltage = feed_forward.map(c);
        for i in 0..N {
            if self.active[i] {
                let error = reference[i] - (encoder[i] - memory.last_angle[i]) / c(self.period);
                let integral = memory.integral[i] + error * self.period;
                let unlimited = voltage[i] + error * self.kp[i] + integral * self.ki[i];
                if unlimited.lane(0).abs() <= self.limit {
                    voltage[i] = unlimited;
                    memory.integral[i] = integral;
                } else {
                    voltage[i] = c(self.limit).copysign(unlimited);
                }
            }
            memory.last_angle[i] = encoder[i];
        }
        voltage
    }
}

impl<const N: usize> Controller<N> for PiVelocity<N> {
    type Memory<R: Real> = PiVelocityMemory<R, N>;

    fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> PiVelocityMemory<R, N> {
        let mut integral = [R::splat(0.0); N];
        for i in 0..N {
            if self.active[i] && self.ki[i] > 0.0 {
                integral[i] = R::splat(voltage[i] / self.ki[i]);
            }
        }
        PiVelocityMemory {
            integral,
            last_angle: *encoder,
        }
    }

    /// `reference` holds motor velocities [rad/s].
    #[inline(always)]
    fn command<R: Real>(
        &self,
        memory: &mut PiVelocityMemory<R, N>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        self.follow(memory, &reference.map(R::splat), encoder, feed_forward)
    }

    fn drives(&self, joint: usize) -> bool {
        self.active[joint]
    }
}
