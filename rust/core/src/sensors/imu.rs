//! Readings of sensors at any place on a link, behind the low-passes of its IMU.

use crate::arm::Arm;
use crate::arm::link_signals::LINK_SIGNALS;
use crate::experiment::Task;
use crate::scalar::Real;
use crate::sensors::low_pass::LowPass;

/// Low-passes of a simulation, and readings for each sensor and link.
pub(crate) struct Imus<R, const N: usize> {
    pub(crate) filters: Vec<[Option<LowPass<R, 2>>; N]>,
    pub(crate) readings: Vec<[R; N]>,
}

impl<R: Real, const N: usize> Imus<R, N> {
    /// Low-passes at rest at the initial signals, for steps of `h` [s].
    pub(crate) fn at_rest<A: Arm<N>>(
        task: &Task<A, N>,
        h: f64,
        signals: &[[R; N]; LINK_SIGNALS],
    ) -> Self {
        let joints = task.config.joints();
        let mut imus = Self {
            filters: Vec::new(),
            readings: Vec::new(),
        };
        for sensor in &task.link_sensors {
            let mut readings = [R::splat(0.0); N];
            let mut filters = [const { None }; N];
            for (i, joint) in joints.iter().enumerate() {
                readings[i] = sensor.read(i, signals);
                let hz = if sensor.is_gyro {
                    joint.imu_gyro_hz
                } else {
                    joint.imu_accelerometer_hz
                };
                filters[i] = hz.map(|hz| LowPass::butterworth(hz, h, readings[i]));
            }
            imus.filters.push(filters);
            imus.readings.push(readings);
        }
        imus
    }

    /// Updates with the signals at the end of a step.
    #[inline(always)]
    pub(crate) fn update<A: Arm<N>>(
        &mut self,
        task: &Task<A, N>,
        signals: &[[R; N]; LINK_SIGNALS],
    ) {
        for (k, sensor) in task.link_sensors.iter().enumerate() {
            for i in 0..task.config.arm.joints() {
                let ideal = sensor.read(i, signals);
                self.readings[k][i] = match &mut self.filters[k][i] {
                    Some(filter) => {
                        filter.update(ideal);
                        filter.output()
                    }
                    None => ideal,
                };
            }
        }
    }
}
