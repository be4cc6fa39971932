//! Signals of an IMU behind its low-passes.

use crate::arm::Arm;
use crate::arm::link_signals::{LINK_SIGNALS, RATES};
use crate::plant::config::Config;
use crate::scalar::Real;
use crate::sensors::low_pass::LowPass;

/// A number per link for each signal.
pub(crate) type Signals<R, const N: usize> = [[R; N]; LINK_SIGNALS];

/// Low-passes of a simulation.
pub(crate) struct Imus<R, const N: usize> {
    pub(crate) filters: [[Option<LowPass<R, 2>>; N]; LINK_SIGNALS],
    pub(crate) readings: Signals<R, N>,
}

impl<R: Real, const N: usize> Imus<R, N> {
    /// Low-passes at rest at the initial signals, for steps of `h` [s].
    pub(crate) fn at_rest<A: Arm<N>>(
        config: &Config<A, N>,
        h: f64,
        readings: Signals<R, N>,
    ) -> Self {
        let filter = |k: usize, i: usize| {
            let joint = config.joints().get(i)?;
            let hz = if k < RATES {
                joint.imu_accelerometer_hz?
            } else {
                joint.imu_gyro_hz?
            };
            Some(LowPass::butterworth(hz, h, readings[k][i]))
        };
        Self {
            filters: std::array::from_fn(|k| std::array::from_fn(|i| filter(k, i))),
            readings,
        }
    }

    /// Updates with the signals at the end of a step.
    #[inline(always)]
    pub(crate) fn update<A: Arm<N>>(&mut self, ideal: &Signals<R, N>) {
        for &k in A::LINK_SIGNALS {
            for i in 0..N {
                self.readings[k][i] = ideal[k][i];
                if let Some(filter) = &mut self.filters[k][i] {
                    filter.update(ideal[k][i]);
                    self.readings[k][i] = filter.output();
                }
            }
        }
    }
}
