//! Readings of sensors on the links, behind their low-passes.

use crate::arm::Arm;
use crate::experiment::{Quantity, Task};
use crate::plant::{Instant, State};
use crate::scalar::Real;
use crate::sensors::low_pass::LowPass;

/// Low-passes and readings of one simulation.
pub(crate) struct Sensors<R, const N: usize> {
    pub(crate) accelerometer: [Option<LowPass<R, 2>>; N],
    pub(crate) gyro: [Option<LowPass<R, 1>>; N],
    /// Accelerometers and gyros at fixed places; not updated unless they are recorded.
    pub(crate) readings: [[R; N]; 2],
    is_recorded: bool,
    /// Low-passes for each sensor at any place, as one of an IMU, and for each link.
    pub(crate) imu_filters: Vec<[Option<LowPass<R, 2>>; N]>,
    pub(crate) imu_readings: Vec<[R; N]>,
}

impl<R: Real, const N: usize> Sensors<R, N> {
    /// Low-passes at rest at the initial readings; `None` if the task records no sensor.
    pub(crate) fn at_rest<A: Arm<N>>(
        task: &Task<A, N>,
        arm: &A,
        x: &State<R, N>,
        now: &Instant<A, R, N>,
    ) -> Option<Self> {
        let is_recorded =
            task.record.contains(&Quantity::Accelerometer) || task.record.contains(&Quantity::Gyro);
        if !is_recorded && task.link_sensors.is_empty() {
            return None;
        }
        let (joints, h) = (task.config.joints(), task.clock.step);
        let readings = ideal_readings(arm, x, now);
        let acceleration = &now.acceleration.link;
        let signals = arm.link_signals(&now.posture, &x.link_velocity, acceleration);
        let mut sensors = Self {
            accelerometer: std::array::from_fn(|i| {
                let hz = joints.get(i)?.accelerometer_hz?;
                Some(LowPass::butterworth(hz, h, readings[0][i]))
            }),
            gyro: std::array::from_fn(|i| {
                let hz = joints.get(i)?.gyro_hz?;
                Some(LowPass::first_order(hz, h, readings[1][i]))
            }),
            readings,
            is_recorded,
            imu_filters: Vec::new(),
            imu_readings: Vec::new(),
        };
        for sensor in &task.link_sensors {
            let mut readings = [R::splat(0.0); N];
            let mut filters = [const { None }; N];
            for (i, joint) in joints.iter().enumerate() {
                readings[i] = sensor.read(i, &signals);
                let hz = if sensor.is_gyro {
                    joint.imu_gyro_hz
                } else {
                    joint.imu_accelerometer_hz
                };
                filters[i] = hz.map(|hz| LowPass::butterworth(hz, h, readings[i]));
            }
            sensors.imu_filters.push(filters);
            sensors.imu_readings.push(readings);
        }
        Some(sensors)
    }

    /// Updates at the end of a step.
    #[inline(always)]
    pub(crate) fn update<A: Arm<N>>(
        &mut self,
        task: &Task<A, N>,
        arm: &A,
        x: &State<R, N>,
        now: &Instant<A, R, N>,
    ) {
        if !task.link_sensors.is_empty() {
            let acceleration = &now.acceleration.link;
            let signals = arm.link_signals(&now.posture, &x.link_velocity, acceleration);
            for (k, sensor) in task.link_sensors.iter().enumerate() {
                for i in 0..arm.joints() {
                    let ideal = sensor.read(i, &signals);
                    self.imu_readings[k][i] = behind(&mut self.imu_filters[k][i], ideal);
                }
            }
        }
        if self.is_recorded {
            let [accelerometers, gyros] = ideal_readings(arm, x, now);
            for i in 0..N {
                self.readings[0][i] = behind(&mut self.accelerometer[i], accelerometers[i]);
                self.readings[1][i] = behind(&mut self.gyro[i], gyros[i]);
            }
        }
    }
}

/// Readings of ideal accelerometers and gyros at fixed places.
#[inline(always)]
fn ideal_readings<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    x: &State<R, N>,
    now: &Instant<A, R, N>,
) -> [[R; N]; 2] {
    let (velocity, acceleration) = (&x.link_velocity, &now.acceleration.link);
    [
        arm.accelerometers(&now.posture, velocity, acceleration),
        arm.absolute_rates(&now.posture, velocity),
    ]
}

/// Reading of a sensor behind its low-pass.
#[inline(always)]
fn behind<R: Real, const M: usize>(filter: &mut Option<LowPass<R, M>>, ideal: R) -> R {
    match filter {
        Some(filter) => {
            filter.update(ideal);
            filter.output()
        }
        None => ideal,
    }
}
