//! Signals of an IMU behind its low-passes.

use crate::arm::Arm;
use crate::arm::link_signals::LINK_SIGNALS;
use crate::plant::config::Config;
use crate::scalar::Real;
use crate::sensors::low_pass::LowPass;

/// f_x, f_y, alpha, w^2, and the rate itself.
pub(crate) const IMU_SIGNALS: usize = LINK_SIGNALS + 1;

/// A number per link for each signal.
pub(crate) type Signals<R, const N: usize> = [[R; N]; IMU_SIGNALS];

/// Low-passes of a simulation.
pub(crate) struct Imus<R, const N: usize> {
    pub(crate) filters: [[Option<LowPass<R, 2>>; N]; IMU_SIGNALS],
    pub(crate) readings: Signals<R, N>,
}

/// The signals before any low-pass.
#[inline(always)]
pub(crate) fn ideal<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    at: &A::Posture<R>,
    dq: &[R; N],
    ddq: &[R; N],
) -> Signals<R, N> {
    let [x, y, turning, square] = arm.link_signals(at, dq, ddq);
    [x, y, turning, square, arm.absolute_rates(at, dq)]
}

impl<R: Real, const N: usize> Imus<R, N> {
    /// Low-passes at rest at the initial signals, for steps of `h` [s].
    pub(crate) fn at_rest<A: Arm<N>>(
        config: &Config<A, N>,
        h: f64,
        readings: Signals<R, N>,
    ) -> Self {
        let filter = |k: usize, i: usize| {
            let joint = &config.joints[i];
            let reading = if k < LINK_SIGNALS {
                joint.imu_accelerometer_hz
            } else {
                joint.imu_gyro_hz
            };
            reading.map(|hz| LowPass::butterworth(hz, h, readings[k][i]))
        };
        Self {
            filters: std::array::from_fn(|k| std::array::from_fn(|i| filter(k, i))),
            readings,
        }
    }

    /// Updates with the signals at the end of a step.
    #[inline(always)]
    pub(crate) fn update(&mut self, ideal: Signals<R, N>) {
        self.readings = ideal;
        for (filters, readings) in self.filters.iter_mut().zip(&mut self.readings) {
            for i in 0..N {
                if let Some(filter) = &mut filters[i] {
                    filter.update(readings[i]);
                    readings[i] = filter.output();
                }
            }
        }
    }
}
