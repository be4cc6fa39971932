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
        let decay = [0.5 * h, h].map(|t| bandwidth.map(|w| decay(w, R::splat(t))));
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
    pub fn over(&self, begin: &[R; N], target: &[R; N], t: R) -> StepTorque<R, N> {
        let (mut middle, mut end) = (*target, *target);
        for i in 0..N {
            let half_way = decay(self.bandwidth[i], R::splat(0.5) * t);
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
#[inline(always)]
fn decay<R: Real>(bandwidth: f64, t: R) -> R {
    if bandwidth.is_infinite() {
        R::splat(0.0)
    } else {
        (R::splat(-bandwidth) * t).exp()
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

/// Encoder reading [rad] of a motor angle: whole counts, or the angle itself without an encoder.
///
/// A derivative that the angle carries is the reading's too: that of the staircase, zero but for
/// its jumps, would say that the encoder sees no motion.
pub fn encoder_angle<R: Real>(angle: R, counts_per_turn: Option<f64>) -> R {
    let mut reading = angle;
    if let Some(counts) = counts_per_turn {
        let count = std::f64::consts::TAU / counts;
        for lane in 0..R::LANES {
            reading.set_lane(lane, (angle.lane(lane) / count).round() * count);
        }
    }
    reading
}
