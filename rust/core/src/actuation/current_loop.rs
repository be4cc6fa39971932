//! From voltage to motor torque.

use crate::scalar::Real;

/// Motor torques [N m] at the beginning, middle and end of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepTorque<R, const N: usize> {
    /// At the beginning.
    pub begin: [R; N],
    /// Half-way.
    pub middle: [R; N],
    /// At the end.
    pub end: [R; N],
}

/// The current loops: torque follows `e u` with a first-order lag, or at once.
#[derive(Clone, Copy, Debug)]
pub struct CurrentLoop<R, const N: usize> {
    /// e [N m/V] at the motor.
    pub torque_per_volt: [f64; N],
    /// Bandwidth [rad/s]; infinite where the torque follows at once.
    pub bandwidth: [f64; N],
    /// What is left of the distance to the target in the middle of a step, see [`mean`], and at
    /// its end.
    decay: [[R; N]; 2],
}

impl<R: Real, const N: usize> CurrentLoop<R, N> {
    /// Loops with given bandwidths [rad/s] for an integrator of step `h` [s].
    pub fn new(torque_per_volt: [f64; N], bandwidth: [f64; N], h: f64) -> Self {
        let h = R::splat(h);
        let decay = [
            bandwidth.map(|w| mean(w, h)),
            bandwidth.map(|w| decay(w, h)),
        ];
        Self {
            torque_per_volt,
            bandwidth,
            decay,
        }
    }

    /// Torques over a whole step towards the held targets: the end and the impulse are exact, for
    /// voltage is constant in a step.
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
            let distance = begin[i] - target[i];
            middle[i] = distance.mul_add(mean(self.bandwidth[i], t), target[i]);
            end[i] = distance.mul_add(decay(self.bandwidth[i], t), target[i]);
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

/// What stands for the middle of a step of length `t` so that Simpson's rule, by which the
/// integrator weighs torques, gives their mean exactly: (6 (1 - e^-x)/x - 1 - e^-x)/4, x = w t.
///
/// It is within x^4/2880 of e^(-x/2), but where a step is as long as the loop's own lag, that is a
/// thousandth of each jump's impulse.
#[inline(always)]
fn mean<R: Real>(bandwidth: f64, t: R) -> R {
    if bandwidth.is_infinite() {
        return R::splat(0.0);
    }
    let x = R::splat(bandwidth) * t;
    let c = R::splat;
    if x.lane(0) < 0.05 {
        // the closed form would cancel
        let fourth = (x * x).mul_add(c(-1.0 / 20_160.0), c(1.0 / 480.0));
        let third = x.mul_add(fourth, c(-1.0 / 48.0));
        return x.mul_add(x.mul_add(x.mul_add(third, c(1.0 / 8.0)), c(-0.5)), c(1.0));
    }
    let left = (-x).exp();
    let one = c(1.0);
    c(0.25) * (c(6.0) * (one - left) / x - one - left)
}
