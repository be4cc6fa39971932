//! Derivatives of the readings of accelerometers and gyros.

use crate::arm::Arm;
use crate::arm::link_signals::summed;
use crate::experiment::simulate::Sensors;
use crate::experiment::{Quantity, Task};
use crate::plant::{Instant, State};
use crate::scalar::Real;
use crate::sensitivity::imu::{ImuReadings, ImuSensing};
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensors::low_pass::Feedthrough;

/// Filters of `M` states of one kind of sensor, joint by joint.
type Filters<V, const N: usize, const M: usize> = [Option<Feedthrough<V, M>>; N];

/// Low-passes and slopes of the recorded sensors, for all blocks.
pub(crate) struct Sensing<V, const N: usize> {
    /// Half steps per second: the derivatives of the motion are in half steps.
    rate: f64,
    accelerometers: Option<Filters<V, N, 2>>,
    gyros: Option<Filters<V, N, 1>>,
    pub(crate) imus: ImuSensing<V, N>,
    slopes: ReadingSlopes<N>,
    rates: RateSlopes<N>,
}

/// States of the filters and readings of one block.
#[derive(Clone)]
pub(crate) struct BlockSensors<V, const N: usize> {
    accelerometers: [[V; 2]; N],
    gyros: [[V; 1]; N],
    /// Accelerometers and gyros.
    pub(crate) readings: [[V; N]; 2],
    pub(crate) imus: ImuReadings<V, N>,
}

/// Slopes of the accelerometers' readings at an instant.
struct ReadingSlopes<const N: usize> {
    angle: [[f64; N]; N],
    velocity: [[f64; N]; N],
    acceleration: [[f64; N]; N],
}

impl<V: Real, const N: usize> Sensing<V, N> {
    /// Sensors of a task, with the states of its simulation; `None` if neither kind is recorded.
    pub(crate) fn new<A: Arm<N>, S: Real>(
        task: &Task<A, N>,
        sensors: Option<&Sensors<S, N>>,
    ) -> Option<Self> {
        let (sensors, is_recorded) = (sensors?, |quantity| task.record.contains(&quantity));
        let accelerometers = sensors.accelerometer.each_ref();
        let gyros = sensors.gyro.each_ref();
        let (rate, joints) = (2.0 / task.clock.step, task.config.arm.joints());
        Some(Self {
            rate,
            accelerometers: is_recorded(Quantity::Accelerometer)
                .then(|| accelerometers.map(|one| Some(one.as_ref()?.feedthrough()))),
            gyros: is_recorded(Quantity::Gyro)
                .then(|| gyros.map(|one| Some(one.as_ref()?.feedthrough()))),
            imus: ImuSensing::new(&task.link_sensors, &sensors.imus, joints, rate),
            slopes: ReadingSlopes {
                angle: [[0.0; N]; N],
                velocity: [[0.0; N]; N],
                acceleration: [[0.0; N]; N],
            },
            rates: RateSlopes {
                angle: [[0.0; N]; N],
                velocity: [[0.0; N]; N],
            },
        })
    }

    /// Computes the slopes of the readings at an instant.
    #[inline(always)]
    pub(crate) fn compute_slopes<A: Arm<N>, S: Real>(
        &mut self,
        arm: &A,
        x: &State<S, N>,
        now: &Instant<A, S, N>,
    ) {
        self.imus.compute_slopes(arm, x, now);
        if !A::PLANAR && self.gyros.is_some() {
            self.rates.compute_slopes(arm, self.rate, x, now);
        }
        if self.accelerometers.is_none() {
            return;
        }
        let (dq, ddq) = (&x.link_velocity, &now.acceleration.link);
        let (slopes, acceleration) = arm.accelerometer_slopes(&now.posture, dq, ddq);
        let (rate, entries) = (self.rate, &mut self.slopes);
        for i in 0..N {
            for j in 0..N {
                entries.angle[i][j] = slopes.angle[i][j].lane(0);
                entries.velocity[i][j] = rate * slopes.velocity[i][j].lane(0);
                entries.acceleration[i][j] = rate * rate * acceleration[i][j].lane(0);
            }
        }
    }
}

impl<V: Real, const N: usize> BlockSensors<V, N> {
    /// Filters at rest at the initial readings of accelerometers and gyros, and of the IMUs.
    pub(crate) fn at_rest(
        sensing: &Sensing<V, N>,
        first: [[V; N]; 2],
        of_imus: Vec<[V; N]>,
    ) -> Self {
        let mut sensors = Self {
            accelerometers: [[V::splat(0.0); 2]; N],
            gyros: [[V::splat(0.0)]; N],
            readings: first,
            imus: ImuReadings::at_rest(&sensing.imus, of_imus),
        };
        for i in 0..N {
            if let Some(Some(filter)) = sensing.accelerometers.as_ref().map(|all| &all[i]) {
                sensors.accelerometers[i] = filter.at_rest(first[0][i]);
            }
            if let Some(Some(filter)) = sensing.gyros.as_ref().map(|all| &all[i]) {
                sensors.gyros[i] = filter.at_rest(first[1][i]);
            }
        }
        sensors
    }

    /// Updates the readings at an instant.
    #[inline(always)]
    pub(crate) fn sense<A: Arm<N>>(
        &mut self,
        arm: &A,
        sensing: &Sensing<V, N>,
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) {
        if let Some(filters) = &sensing.accelerometers {
            let ideal = sensing.slopes.tangents::<A, V>(x, response);
            self.readings[0] = ideal;
            for i in 0..N {
                if let Some(filter) = &filters[i] {
                    self.readings[0][i] = filter.update(&mut self.accelerometers[i], ideal[i]);
                }
            }
        }
        self.imus.sense(arm, &sensing.imus, x, response);
        if let Some(filters) = &sensing.gyros {
            let ideal = sensing.rates.tangents::<A, V>(sensing.rate, x);
            self.readings[1] = ideal;
            for i in 0..N {
                if let Some(filter) = &filters[i] {
                    self.readings[1][i] = filter.update(&mut self.gyros[i], ideal[i]);
                }
            }
        }
    }
}

impl<const N: usize> ReadingSlopes<N> {
    /// Derivatives of the readings, from the nonzero entries of [`Arm::accelerometer_slopes`].
    #[inline(always)]
    fn tangents<A: Arm<N>, V: Real>(&self, x: &Tangent<V, N>, response: &Response<V, N>) -> [V; N] {
        let (c, mut sum) = (V::splat, [V::splat(0.0); N]);
        for i in 0..N {
            for j in 0..i + usize::from(!A::PLANAR) {
                sum[i] = c(self.velocity[i][j]).mul_add(x.link[j], sum[i]);
            }
            for j in 0..=i {
                if A::DEPENDS_ON_ANGLE[j] {
                    sum[i] = c(self.angle[i][j]).mul_add(x.angle[j], sum[i]);
                }
            }
            // the accelerations are the last result of the equations
            for j in 0..=i {
                sum[i] = c(self.acceleration[i][j]).mul_add(response.link[j], sum[i]);
            }
        }
        sum
    }
}

/// Slopes of the links' rates in space at an instant, for arms that are not planar.
struct RateSlopes<const N: usize> {
    angle: [[f64; N]; N],
    velocity: [[f64; N]; N],
}

impl<const N: usize> RateSlopes<N> {
    /// Computes the slopes, in half steps of 1/`rate` [s].
    #[inline(always)]
    fn compute_slopes<A: Arm<N>, S: Real>(
        &mut self,
        arm: &A,
        rate: f64,
        x: &State<S, N>,
        now: &Instant<A, S, N>,
    ) {
        let slopes = arm.rate_slopes(&now.posture, &x.link_velocity);
        for i in 0..N {
            for j in 0..N {
                self.angle[i][j] = slopes.angle[i][j].lane(0);
                self.velocity[i][j] = rate * slopes.velocity[i][j].lane(0);
            }
        }
    }

    /// Derivatives of the rates [rad/s].
    #[inline(always)]
    fn tangents<A: Arm<N>, V: Real>(&self, rate: f64, x: &Tangent<V, N>) -> [V; N] {
        if A::PLANAR {
            return summed(&x.link.map(|one| V::splat(rate) * one));
        }
        let mut sum = [V::splat(0.0); N];
        for i in 0..N {
            for j in 0..=i {
                sum[i] = V::splat(self.angle[i][j]).mul_add(x.angle[j], sum[i]);
                sum[i] = V::splat(self.velocity[i][j]).mul_add(x.link[j], sum[i]);
            }
        }
        sum
    }
}
