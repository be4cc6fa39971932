//! Derivatives of the readings of sensors at any place on a link.

use crate::arm::Arm;
use crate::arm::link_signals::LinkSensor;
use crate::plant::{Instant, State};
use crate::scalar::{Jet, Real};
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensors::imu::Imus;
use crate::sensors::low_pass::{Feedthrough, LowPass};

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
        plain: &Imus<S, N>,
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
                .filters
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
