//! Sensors with a bandwidth, as exact discrete filters at the integrator's step.

use crate::scalar::Real;

/// A continuous-time low-pass of `M` states with unit gain, whose first state is the output,
/// discretised exactly for an input that is linear within each step (first-order hold).
#[derive(Clone, Copy, Debug)]
pub struct LowPass<R, const M: usize> {
    transition: [[R; M]; M],
    from_old: [R; M],
    from_new: [R; M],
    state: [R; M],
    input: R,
}

impl<R: Real> LowPass<R, 1> {
    /// First order, of bandwidth `hz`, at rest at the reading `at`.
    pub fn first_order(hz: f64, h: f64, at: R) -> Self {
        let w = std::f64::consts::TAU * hz;
        Self::discretised([[-w]], [w], h, [at], at)
    }
}

impl<R: Real> LowPass<R, 2> {
    /// Second-order Butterworth, of bandwidth `hz`, at rest at the reading `at`.
    ///
    /// States: the output y and y'/w; y'' = w^2 (u - y) - sqrt(2) w y'.
    pub fn butterworth(hz: f64, h: f64, at: R) -> Self {
        let w = std::f64::consts::TAU * hz;
        let damping = -std::f64::consts::SQRT_2 * w;
        Self::discretised(
            [[0.0, w], [-w, damping]],
            [0.0, w],
            h,
            [at, R::splat(0.0)],
            at,
        )
    }
}

impl<R: Real, const M: usize> LowPass<R, M> {
    /// With u(t) = u0 + (u1 - u0) t/h, exp of [[A, B, 0], [0, 0, 1/h], [0, 0, 0]] h contains the
    /// transition matrix and the two input columns.
    fn discretised(a: [[f64; M]; M], b: [f64; M], h: f64, state: [R; M], input: R) -> Self {
        let size = M + 2;
        let mut generator = vec![vec![0.0; size]; size];
        for i in 0..M {
            for j in 0..M {
                generator[i][j] = a[i][j] * h;
            }
            generator[i][M] = b[i] * h;
        }
        generator[M][M + 1] = 1.0;
        let exponential = exponential(&generator);
        let column = |j: usize| -> [f64; M] { std::array::from_fn(|i| exponential[i][j]) };
        let (held, sloped) = (column(M), column(M + 1));
        Self {
            transition: std::array::from_fn(|i| {
                std::array::from_fn(|j| R::splat(exponential[i][j]))
            }),
            from_old: std::array::from_fn(|i| R::splat(held[i] - sloped[i])),
            from_new: std::array::from_fn(|i| R::splat(sloped[i])),
            state,
            input,
        }
    }

    /// Updates with the reading at the end of a step.
    #[inline(always)]
    pub fn update(&mut self, input: R) {
        let old = self.state;
        for i in 0..M {
            let mut next = self.from_old[i].mul_add(self.input, self.from_new[i] * input);
            for j in 0..M {
                next = self.transition[i][j].mul_add(old[j], next);
            }
            self.state[i] = next;
        }
        self.input = input;
    }

    /// The filter for derivatives of the readings.
    pub(crate) fn feedthrough<V: Real>(&self) -> Feedthrough<V, M> {
        let plain = |row: &[R; M]| row.map(|number| number.lane(0));
        let (transition, newest) = (self.transition.each_ref().map(plain), plain(&self.from_new));
        let mut by_reading = plain(&self.from_old);
        for i in 0..M {
            for j in 0..M {
                by_reading[i] += transition[i][j] * newest[j];
            }
        }
        Feedthrough {
            transition: transition.map(|row| row.map(V::splat)),
            by_reading: by_reading.map(V::splat),
            by_newest: newest.map(V::splat),
        }
    }

    /// Output of the sensor.
    #[inline(always)]
    pub fn output(&self) -> R {
        self.state[0]
    }
}

/// A [`LowPass`] with the share `c u` of the newest reading removed from its state: y = s_0 + c_0
/// u, s+ = A s + e u.
///
/// It needs one product less per state, and its constants serve all directions.
#[derive(Clone, Copy)]
pub(crate) struct Feedthrough<V, const M: usize> {
    transition: [[V; M]; M],
    by_reading: [V; M],
    by_newest: [V; M],
}

impl<V: Real, const M: usize> Feedthrough<V, M> {
    /// The state at rest at a reading.
    pub(crate) fn at_rest(&self, reading: V) -> [V; M] {
        let mut state = self.by_newest.map(|newest| -(newest * reading));
        state[0] = state[0] + reading;
        state
    }

    /// Updates with a reading, and returns the output.
    #[inline(always)]
    pub(crate) fn update(&self, state: &mut [V; M], reading: V) -> V {
        let old = *state;
        for i in 0..M {
            let mut next = self.by_reading[i] * reading;
            for j in 0..M {
                next = self.transition[i][j].mul_add(old[j], next);
            }
            state[i] = next;
        }
        self.by_newest[0].mul_add(reading, old[0])
    }
}

/// Matrix exponential by scaling, a Taylor series truncated below rounding, and squaring.
fn exponential(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let n = matrix.len();
    let norm = matrix
        .iter()
        .map(|row| row.iter().map(|x| x.abs()).sum::<f64>())
        .fold(0.0, f64::max);
    let squarings = (norm.max(1e-300).log2().ceil() + 3.0).max(0.0) as i32;
    let scale = 0.5f64.powi(squarings);
    let product = |a: &[Vec<f64>], b: &[Vec<f64>]| -> Vec<Vec<f64>> {
        (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| (0..n).map(|k| a[i][k] * b[k][j]).sum())
                    .collect()
            })
            .collect()
    };
    let identity: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect())
        .collect();
    let scaled: Vec<Vec<f64>> = matrix
        .iter()
        .map(|row| row.iter().map(|x| x * scale).collect())
        .collect();
    let (mut sum, mut term) = (identity.clone(), identity);
    for order in 1..=14 {
        term = product(&term, &scaled);
        for i in 0..n {
            for j in 0..n {
                term[i][j] /= f64::from(order);
                sum[i][j] += term[i][j];
            }
        }
    }
    for _ in 0..squarings {
        sum = product(&sum, &sum);
    }
    sum
}

#[cfg(test)]
mod tests;
