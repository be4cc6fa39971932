//! Current loops, from voltage to motor torque.

use crate::scalar::Real;

/// Motor torques [N m] at the beginning, middle and end of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepTorque<R, const N: usize> {
    /// At the beginning.
    pub begin: [R; N],
    /// At the middle.
    pub middle: [R; N],
    /// At the end.
    pub end: [R; N],
}

/// Current loops: the torque follows `e u` with a first-order lag, or without one.
#[derive(Clone, Copy, Debug)]
pub struct CurrentLoop<R, const N: usize> {
    /// e [N m/V] at the motor.
    pub torque_per_volt: [f64; N],
    /// Bandwidth [rad/s]; infinite without a lag.
    pub bandwidth: [f64; N],
    /// Remaining share of the distance to the target at the middle of a step, see [`mean`], and at
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

    /// Torques over a whole step towards constant targets. The end and the impulse are exact,
    /// because the voltage is constant within a step.
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

    /// Torques over a part of a step of `t` seconds.
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

/// Remaining share of the distance to the target after `t` seconds; zero without a lag.
#[inline(always)]
fn decay<R: Real>(bandwidth: f64, t: R) -> R {
    if bandwidth.is_infinite() {
        R::splat(0.0)
    } else {
        (t * -bandwidth).exp()
    }
}

/// Share that represents the middle of a step of length `t`, so that Simpson's rule, by which the
/// integrator weights torques, gives the exact mean: (6 (1 - e^-x)/x - 1 - e^-x)/4, x = w t.
///
/// It differs from e^(-x/2) by less than x^4/2880. For a step as long as the lag, that would be a
/// thousandth of the impulse of each voltage step.
#[inline(always)]
fn mean<R: Real>(bandwidth: f64, t: R) -> R {
    if bandwidth.is_infinite() {
        return R::splat(0.0);
    }
    let x = t * bandwidth;
    let c = R::splat;
    if x.lane(0) < 0.05 {
        // the closed form would lose digits by cancellation
        let fourth = (x * x).mul_add(c(-1.0 / 20_160.0), c(1.0 / 480.0));
        let third = x.mul_add(fourth, c(-1.0 / 48.0));
        return x.mul_add(x.mul_add(x.mul_add(third, c(1.0 / 8.0)), c(-0.5)), c(1.0));
    }
    let share = (-x).exp();
    let one = c(1.0);
    ((one - share) * 6.0 / x - one - share) * 0.25
}
