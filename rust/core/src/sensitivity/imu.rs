//! Derivatives of the readings of an IMU.

use crate::arm::Arm;
use crate::arm::link_signals::{LINK_SIGNALS, LinkSignalSlopes, RATE};
use crate::plant::{Instant, State};
use crate::scalar::Real;
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensors::imu::{Imus, Signals};
use crate::sensors::low_pass::{Feedthrough, LowPass};

/// Low-passes and slopes for all blocks.
pub(crate) struct ImuSensing<V, const N: usize> {
    filters: [[Option<Feedthrough<V, 2>>; N]; LINK_SIGNALS],
    slopes: [LinkSignalSlopes<f64, N>; N],
}

/// States of the low-passes and readings of one block.
#[derive(Clone)]
pub(crate) struct ImuReadings<V, const N: usize> {
    states: [[[V; 2]; N]; LINK_SIGNALS],
    pub(crate) readings: Signals<V, N>,
}

impl<V: Real, const N: usize> ImuSensing<V, N> {
    /// From the low-passes of a simulation.
    pub(crate) fn new<S: Real>(plain: &Imus<S, N>) -> Self {
        let none = LinkSignalSlopes {
            angle: [[0.0; N]; LINK_SIGNALS],
            velocity: [[0.0; N]; LINK_SIGNALS],
            acceleration: [[0.0; N]; LINK_SIGNALS],
        };
        let of = |one: &Option<LowPass<S, 2>>| Some(one.as_ref()?.feedthrough());
        Self {
            filters: plain.filters.each_ref().map(|row| row.each_ref().map(of)),
            slopes: [none; N],
        }
    }

    /// Computes the slopes of the signals at an instant, in half steps of 1/`rate` [s].
    #[inline(always)]
    pub(crate) fn compute_slopes<A: Arm<N>, S: Real>(
        &mut self,
        arm: &A,
        rate: f64,
        x: &State<S, N>,
        now: &Instant<A, S, N>,
    ) {
        let (dq, ddq) = (&x.link_velocity, &now.acceleration.link);
        let slopes = arm.link_signal_slopes(&now.posture, dq, ddq);
        for (entries, from) in self.slopes.iter_mut().zip(&slopes) {
            for &k in A::LINK_SIGNALS {
                for j in 0..N {
                    entries.angle[k][j] = from.angle[k][j].lane(0);
                    entries.velocity[k][j] = rate * from.velocity[k][j].lane(0);
                    entries.acceleration[k][j] = rate * rate * from.acceleration[k][j].lane(0);
                }
            }
        }
    }

    /// Derivative of a link's signal before any low-pass.
    #[inline(always)]
    fn tangent<A: Arm<N>>(
        &self,
        [k, i]: [usize; 2],
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) -> V {
        let (slopes, mut all) = (&self.slopes[i], V::splat(0.0));
        for j in 0..=i {
            all = V::splat(slopes.velocity[k][j]).mul_add(x.link[j], all);
            if A::DEPENDS_ON_ANGLE[j] {
                all = V::splat(slopes.angle[k][j]).mul_add(x.angle[j], all);
            }
            let slope = V::splat(slopes.acceleration[k][j]);
            all = slope.mul_add(response.link[j], all);
        }
        all
    }
}

impl<V: Real, const N: usize> ImuReadings<V, N> {
    /// Low-passes at rest at the derivatives of the initial signals.
    pub(crate) fn at_rest(sensing: &ImuSensing<V, N>, first: Signals<V, N>) -> Self {
        let rest = |k: usize, i: usize| match &sensing.filters[k][i] {
            Some(filter) => filter.at_rest(first[k][i]),
            None => [V::splat(0.0); 2],
        };
        Self {
            states: std::array::from_fn(|k| std::array::from_fn(|i| rest(k, i))),
            readings: first,
        }
    }

    /// Updates the readings at an instant; `rates` are those of a planar arm's links in space.
    #[inline(always)]
    pub(crate) fn sense<A: Arm<N>>(
        &mut self,
        sensing: &ImuSensing<V, N>,
        rates: [V; N],
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) {
        for &k in A::LINK_SIGNALS {
            for i in 0..N {
                let tangent = if A::PLANAR && k == RATE {
                    rates[i]
                } else {
                    sensing.tangent::<A>([k, i], x, response)
                };
                self.readings[k][i] = match &sensing.filters[k][i] {
                    Some(filter) => filter.update(&mut self.states[k][i], tangent),
                    None => tangent,
                };
            }
        }
    }
}
