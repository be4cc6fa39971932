//! From voltage to motor torque, and the servo that commands the voltage.

use crate::plant::StepTorque;
use crate::real::Real;

/// The current loops: torque follows `e u` with a first-order lag, or at once.
#[derive(Clone, Copy, Debug)]
pub struct CurrentLoop<R, const N: usize> {
    /// e [N m/V] at the motor.
    pub torque_per_volt: [f64; N],
    /// Bandwidth [rad/s]; infinite where the torque follows at once.
    pub bandwidth: [f64; N],
    /// Decay of the distance to the target over half a step and over a whole one.
    decay: [[R; N]; 2],
}

impl<R: Real, const N: usize> CurrentLoop<R, N> {
    /// Loops with given bandwidths [rad/s] for an integrator of step `h` [s].
    pub fn new(torque_per_volt: [f64; N], bandwidth: [f64; N], h: f64) -> Self {
        let decay = [0.5 * h, h].map(|t| bandwidth.map(|w| R::splat(decay(w, t))));
        Self {
            torque_per_volt,
            bandwidth,
            decay,
        }
    }

    /// Torques over a whole step towards the held targets: exact, voltage is constant in a step.
    #[inline(always)]
    pub fn over_step(&self, begin: &[R; N], target: &[R; N]) -> StepTorque<R, N> {
        let after = |decay: &[R; N]| {
            let mut torque = *target;
            for i in 0..N {
                torque[i] = (begin[i] - target[i]).mul_add(decay[i], target[i]);
            }
            torque
        };
        StepTorque {
            begin: *begin,
            middle: after(&self.decay[0]),
            end: after(&self.decay[1]),
        }
    }

    /// Torques over a part of a step, `t` seconds long.
    #[inline(always)]
    pub fn over(&self, begin: &[R; N], target: &[R; N], t: f64) -> StepTorque<R, N> {
        let (mut middle, mut end) = (*target, *target);
        for i in 0..N {
            let half_way = R::splat(decay(self.bandwidth[i], 0.5 * t));
            let distance = begin[i] - target[i];
            middle[i] = distance.mul_add(half_way, target[i]);
            end[i] = distance.mul_add(half_way * half_way, target[i]);
        }
        StepTorque {
            begin: *begin,
            middle,
            end,
        }
    }
}

/// What is left of a distance to the target after `t` seconds; nothing if the loop is ideal.
fn decay(bandwidth: f64, t: f64) -> f64 {
    if bandwidth.is_infinite() {
        0.0
    } else {
        (-bandwidth * t).exp()
    }
}

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
pub struct ServoState<const N: usize> {
    /// Integral of the velocity error [rad].
    pub integral: [f64; N],
    /// Encoder angle at the last tick [rad].
    pub last_angle: [f64; N],
}

impl<const N: usize> Servo<N> {
    /// Voltages for the coming period: u = kp e + ki integral(e) + feed-forward, limited.
    ///
    /// e = reference - encoder difference / period, and the integral takes in this tick's error
    /// before it is used (backward Euler).
    pub fn command(
        &self,
        state: &mut ServoState<N>,
        reference: &[f64; N],
        encoder: &[f64; N],
        feed_forward: &[f64; N],
    ) -> [f64; N] {
        let mut voltage = *feed_forward;
        for i in 0..N {
            if self.active[i] {
                let error = reference[i] - (encoder[i] - state.last_angle[i]) / self.period;
                let integral = state.integral[i] + error * self.period;
                let wanted = feed_forward[i] + self.kp[i] * error + self.ki[i] * integral;
                voltage[i] = wanted.clamp(-self.limit, self.limit);
                if voltage[i] == wanted {
                    state.integral[i] = integral;
                }
            }
            state.last_angle[i] = encoder[i];
        }
        voltage
    }
}

/// Encoder reading [rad] of a motor angle: whole counts, or the angle itself without an encoder.
pub fn encoder_angle(angle: f64, counts_per_turn: Option<f64>) -> f64 {
    match counts_per_turn {
        Some(counts) => {
            let count = std::f64::consts::TAU / counts;
            (angle / count).round() * count
        }
        None => angle,
    }
}
