//! The servo that commands the voltages.

use crate::scalar::Real;

/// A PI velocity servo on encoder differences, one a joint.
#[derive(Clone, Copy, Debug)]
pub struct Servo<const N: usize> {
    /// kp [V s/rad].
    pub kp: [f64; N],
    /// ki [V/rad].
    pub ki: [f64; N],
    /// Largest voltage [V]; the integrator stands still while the output is limited.
    pub limit: f64,
    /// Time between two readings [s].
    pub period: f64,
    /// Which joints it drives; the others get their feed-forward voltage alone.
    pub active: [bool; N],
}

/// What one arm's servo remembers.
#[derive(Clone, Copy, Debug)]
pub struct ServoState<R, const N: usize> {
    /// Integral of the velocity error [rad].
    pub integral: [R; N],
    /// Encoder angle at the last tick [rad].
    pub last_angle: [R; N],
}

impl<const N: usize> Servo<N> {
    /// Voltages for the coming period: u = kp e + ki integral(e) + feed-forward, limited.
    ///
    /// e = reference - encoder difference / period, and the integral takes in this tick's error
    /// before it is used (backward Euler).
    pub fn command<R: Real>(
        &self,
        state: &mut ServoState<R, N>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        const { assert!(R::LANES == 1) };
        let c = R::splat;
        let mut voltage = feed_forward.map(c);
        for i in 0..N {
            if self.active[i] {
                let error = c(reference[i]) - (encoder[i] - state.last_angle[i]) / c(self.period);
                let integral = state.integral[i] + error * c(self.period);
                let wanted = voltage[i] + c(self.kp[i]) * error + c(self.ki[i]) * integral;
                if wanted.lane(0).abs() <= self.limit {
                    voltage[i] = wanted;
                    state.integral[i] = integral;
                } else {
                    voltage[i] = c(self.limit).copysign(wanted);
                }
            }
            state.last_angle[i] = encoder[i];
        }
        voltage
    }
}
