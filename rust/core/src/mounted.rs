//! What the sensors of an IMU read combinations of, behind its low-passes: in the plain simulation,
//! and for columns of directions.

use crate::arm::{Accelerometers, Arm};
use crate::basis::{BASIS, BasisSlopes, basis, basis_slopes};
use crate::column::{Response, Tangent};
use crate::config::Config;
use crate::experiment::MOUNTED;
use crate::plant::{Instant, State};
use crate::real::Real;
use crate::sensors::{Feedthrough, LowPass};

/// A number of each link for each of the signals: f_x, f_y, alpha, w^2, and the rate itself.
type Signals<R, const N: usize> = [[R; N]; MOUNTED];

/// The low-passes of the plain simulation.
pub(crate) struct Mounted<R, const N: usize> {
    filters: [[Option<LowPass<R, 2>>; N]; MOUNTED],
    pub(crate) readings: Signals<R, N>,
}

/// The signals before any low-pass.
#[inline(always)]
pub(crate) fn ideal<A: Arm<N>, R: Real, const N: usize>(
    places: &Accelerometers<N>,
    at: &A::Posture<R>,
    dq: &[R; N],
    ddq: &[R; N],
) -> Signals<R, N> {
    let [x, y, turning, square] = basis::<A, R, N>(places, at, dq, ddq);
    [x, y, turning, square, A::absolute_rates(dq)]
}

impl<R: Real, const N: usize> Mounted<R, N> {
    /// At rest at the first signals, for steps of `h` [s].
    pub(crate) fn at_rest<A: Arm<N>>(
        config: &Config<A, N>,
        h: f64,
        readings: Signals<R, N>,
    ) -> Self {
        let filter = |k: usize, i: usize| {
            let joint = &config.joints[i];
            let own = if k < BASIS {
                joint.imu_accelerometer_hz
            } else {
                joint.imu_gyro_hz
            };
            own.map(|hz| LowPass::butterworth(hz, h, readings[k][i]))
        };
        Self {
            filters: std::array::from_fn(|k| std::array::from_fn(|i| filter(k, i))),
            readings,
        }
    }

    /// Takes in the signals at the end of a step.
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

/// The low-passes and slopes that all columns share.
pub(crate) struct MountedSensing<V, const N: usize> {
    filters: [[Option<Feedthrough<V, 2>>; N]; MOUNTED],
    slopes: [BasisSlopes<f64, N>; N],
}

/// One column's states of the low-passes, and its readings.
#[derive(Clone)]
pub(crate) struct MountedSensed<V, const N: usize> {
    states: [[[V; 2]; N]; MOUNTED],
    pub(crate) readings: Signals<V, N>,
}

impl<V: Real, const N: usize> MountedSensing<V, N> {
    /// Of the low-passes of a plain simulation.
    pub(crate) fn new<S: Real>(plain: &Mounted<S, N>) -> Self {
        let none = BasisSlopes {
            angle: [[0.0; N]; BASIS],
            velocity: [[0.0; N]; BASIS],
            acceleration: [[0.0; N]; BASIS],
        };
        let of = |one: &Option<LowPass<S, 2>>| Some(one.as_ref()?.feedthrough());
        Self {
            filters: plain.filters.each_ref().map(|row| row.each_ref().map(of)),
            slopes: [none; N],
        }
    }

    /// Takes how the signals of an instant depend on the motion, in half steps of 1/`rate` [s].
    #[inline(always)]
    pub(crate) fn take<A: Arm<N>, S: Real>(
        &mut self,
        places: &Accelerometers<N>,
        rate: f64,
        x: &State<S, N>,
        now: &Instant<A, S, N>,
    ) {
        let (dq, ddq) = (&x.link_velocity, &now.acceleration.link);
        let slopes = basis_slopes::<A, S, N>(places, &now.posture, dq, ddq);
        for (own, from) in self.slopes.iter_mut().zip(&slopes) {
            for k in 0..BASIS {
                for j in 0..N {
                    own.angle[k][j] = from.angle[k][j].lane(0);
                    own.velocity[k][j] = rate * from.velocity[k][j].lane(0);
                    own.acceleration[k][j] = rate * rate * from.acceleration[k][j].lane(0);
                }
            }
        }
    }

    /// The signals' derivatives before any low-pass.
    #[inline(always)]
    fn tangents<A: Arm<N>>(
        &self,
        rate: f64,
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) -> Signals<V, N> {
        let mut all = [[V::splat(0.0); N]; MOUNTED];
        for (i, slopes) in self.slopes.iter().enumerate() {
            for k in 0..BASIS {
                for j in 0..=i {
                    let mut sum = all[k][i];
                    sum = V::splat(slopes.velocity[k][j]).mul_add(x.link[j], sum);
                    if A::FELT[j] {
                        sum = V::splat(slopes.angle[k][j]).mul_add(x.angle[j], sum);
                    }
                    let turning = V::splat(slopes.acceleration[k][j]);
                    all[k][i] = turning.mul_add(response.link[j], sum);
                }
            }
        }
        all[BASIS] = A::absolute_rates(&x.link.map(|one| V::splat(rate) * one));
        all
    }
}

impl<V: Real, const N: usize> MountedSensed<V, N> {
    /// At rest at the derivatives of the first signals.
    pub(crate) fn at_rest(sensing: &MountedSensing<V, N>, first: Signals<V, N>) -> Self {
        let rest = |k: usize, i: usize| match &sensing.filters[k][i] {
            Some(filter) => filter.at_rest(first[k][i]),
            None => [V::splat(0.0); 2],
        };
        Self {
            states: std::array::from_fn(|k| std::array::from_fn(|i| rest(k, i))),
            readings: first,
        }
    }

    /// The readings of an instant, and what the low-passes make of them.
    #[inline(always)]
    pub(crate) fn sense<A: Arm<N>>(
        &mut self,
        sensing: &MountedSensing<V, N>,
        rate: f64,
        x: &Tangent<V, N>,
        response: &Response<V, N>,
    ) {
        self.readings = sensing.tangents::<A>(rate, x, response);
        for k in 0..MOUNTED {
            for i in 0..N {
                if let Some(filter) = &sensing.filters[k][i] {
                    let reading = &mut self.readings[k][i];
                    *reading = filter.update(&mut self.states[k][i], *reading);
                }
            }
        }
    }
}
