//! Derivatives of the readings of sensors on the links, at fixed places and at any place.

use crate::arm::Arm;
use crate::arm::link_signals::{LinkSensor, summed};
use crate::experiment::{Quantity, Task};
use crate::plant::{Instant, State};
use crate::scalar::{Jet, Real};
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensors::link_sensors::Sensors;
use crate::sensors::low_pass::{Feedthrough, LowPass};

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
            imus: ImuSensing::new(&task.link_sensors, sensors, joints, rate),
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
            return summed(&x.link.map(|one| one * rate));
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

/// Angles, velocities and accelerations.
const KINDS: usize = 3;

/// Low-passes and slopes for all blocks.
pub(crate) struct ImuSensing<V, const N: usize> {
    sensors: Vec<LinkSensor>,
    filters: Vec<[Option<Feedthrough<V, 2>>; N]>,
    /// Derivatives of angles, velocities and accelerations in the directions of slopes, one in each
    /// lane.
    seeds: Vec<[[V; N]; KINDS]>,
    /// Slopes of each sensor's reading on each link by angles, velocities and accelerations.
    slopes: Vec<[[[f64; N]; KINDS]; N]>,
}

/// States of the low-passes and readings of one block, for each sensor and link.
#[derive(Clone)]
pub(crate) struct ImuReadings<V, const N: usize> {
    states: Vec<[[V; 2]; N]>,
    pub(crate) readings: Vec<[V; N]>,
}

impl<V: Real, const N: usize> ImuSensing<V, N> {
    /// From the low-passes of a simulation of `joints` joints. Derivatives of the motion are in
    /// half steps of 1/`rate` [s].
    pub(crate) fn new<S: Real>(
        sensors: &[LinkSensor],
        plain: &Sensors<S, N>,
        joints: usize,
        rate: f64,
    ) -> Self {
        let of = |one: &Option<LowPass<S, 2>>| Some(one.as_ref()?.feedthrough());
        let slopes = KINDS * joints;
        let seeds = (0..slopes).step_by(V::LANES).map(|first| {
            let mut seeds = [[V::splat(0.0); N]; KINDS];
            for slope in first..slopes.min(first + V::LANES) {
                let (kind, joint) = (slope / joints, slope % joints);
                seeds[kind][joint].set_lane(slope - first, rate.powi(kind as i32));
            }
            seeds
        });
        Self {
            sensors: sensors.to_vec(),
            filters: plain
                .imu_filters
                .iter()
                .map(|row| row.each_ref().map(of))
                .collect(),
            seeds: seeds.collect(),
            slopes: vec![[[[0.0; N]; KINDS]; N]; sensors.len()],
        }
    }

    /// Computes the slopes of the readings at an instant by forward differentiation.
    #[inline(always)]
    pub(crate) fn compute_slopes<A: Arm<N>, S: Real>(
        &mut self,
        arm: &A,
        x: &State<S, N>,
        now: &Instant<A, S, N>,
    ) {
        if self.sensors.is_empty() {
            return;
        }
        let lift = |value: S| Jet::constant(V::splat(value.lane(0)));
        let at = A::map_posture(&now.posture, lift);
        let joints = arm.joints();
        for (block, seeds) in self.seeds.iter().enumerate() {
            let mut motion = [
                [Jet::constant(V::splat(0.0)); N],
                x.link_velocity.map(lift),
                now.acceleration.link.map(lift),
            ];
            for (values, tangents) in motion.iter_mut().zip(seeds) {
                for (value, tangent) in values.iter_mut().zip(tangents) {
                    value.tangent = *tangent;
                }
            }
            let [increment, velocity, acceleration] = motion;
            let signals = arm.link_signals(&arm.near(&at, &increment), &velocity, &acceleration);
            let tangents = signals.map(|row| row.map(|one| one.tangent));
            let first = block * V::LANES;
            for (sensor, slopes) in self.sensors.iter().zip(&mut self.slopes) {
                for (i, by) in slopes.iter_mut().enumerate().take(joints) {
                    let reading = sensor.read(i, &tangents);
                    for slope in first..(KINDS * joints).min(first + V::LANES) {
                        by[slope / joints][slope % joints] = reading.lane(slope - first);
                    }
                }
            }
        }
    }
}

/// Derivative of a reading on link `i` before any low-pass.
#[inline(always)]
fn tangent<A: Arm<N>, V: Real, const N: usize>(
    i: usize,
    [angle, velocity, acceleration]: &[[f64; N]; KINDS],
    x: &Tangent<V, N>,
    response: &Response<V, N>,
) -> V {
    let mut all = V::splat(0.0);
    for j in 0..=i {
        all = V::splat(velocity[j]).mul_add(x.link[j], all);
        if A::DEPENDS_ON_ANGLE[j] {
            all = V::splat(angle[j]).mul_add(x.angle[j], all);
        }
        all = V::splat(acceleration[j]).mul_add(response.link[j], all);
    }
    all
}

impl<V: Real, const N: usize> ImuReadings<V, N> {
    /// Low-passes at rest at the derivatives of the initial readings.
    pub(crate) fn at_rest(sensing: &ImuSensing<V, N>, first: Vec<[V; N]>) -> Self {
        let states = sensing.filters.iter().zip(&first).map(|(filters, first)| {
            std::array::from_fn(|i| match &filters[i] {
                Some(filter) => filter.at_rest(first[i]),
                None => [V::splat(0.0); 2],
            })
        });
        Self {
            states: states.collect(),
            readings: first,
        }
    }

    /// Updates the readings at an instant.
    #[inline(always)]
    pub(crate) fn sense<A: Arm<N>>(
        &mut self,
        arm: &A,
        sensing: &ImuSensing<V, N>,
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) {
        for (k, slopes) in sensing.slopes.iter().enumerate() {
            for i in 0..arm.joints() {
                let ideal = tangent::<A, V, N>(i, &slopes[i], x, response);
                self.readings[k][i] = match &sensing.filters[k][i] {
                    Some(filter) => filter.update(&mut self.states[k][i], ideal),
                    None => ideal,
                };
            }
        }
    }
}
