//! One-step predictor: innovations from data.

use crate::model::{Model, Record, Shape};
use strainwave_numerics::products::{BASELINE_IS_FUSED, multiply_add};

/// Largest number of samples of a block; its signals and states fit into the first-level cache.
pub const BLOCK: usize = 64;

/// Innovations of outputs with a root mean square of one that exceed this limit diverge.
pub const DIVERGENCE_RATIO: f64 = 1e3;

/// Values of one channel or state in a block.
pub type Signal = [f64; BLOCK];

/// One-step predictor of one record.
///
/// The products with inputs are computed first, for a whole block in vectors. K multiplies the
/// innovations rather than the outputs, because a large K would multiply the rounding of the latter.
pub struct Predictor<'a> {
    model: &'a Model,
    /// Inputs, and outputs without D u.
    channels: Vec<Signal>,
    /// B u, which [`Self::advance`] replaces by the states.
    states: Vec<Signal>,
    x: Vec<f64>,
}

impl<'a> Predictor<'a> {
    /// The predictor at the first sample of record `index`.
    pub fn new(model: &'a Model, index: usize) -> Self {
        let shape = model.shape;
        Self {
            model,
            channels: vec![[0.0; BLOCK]; shape.inputs + shape.outputs],
            states: vec![[0.0; BLOCK]; shape.order],
            x: model.initial_state(index).to_vec(),
        }
    }

    /// States of the last block, one signal each.
    ///
    /// An unstable A amplifies rounding: states that are computed again from the innovations
    /// diverge from these.
    pub fn states(&self) -> &[Signal] {
        &self.states
    }

    /// Innovations e[k] = y[k] - C x[k] - D u[k] of the next samples, at most [`BLOCK`].
    ///
    /// Uses vectors if the processor has them, decided at run time on x86-64.
    pub fn advance(&mut self, samples: &[f64], e: &mut [f64]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: both features have just been detected.
            return unsafe { self.block_avx2(samples, e) };
        }
        self.block::<BASELINE_IS_FUSED>(samples, e);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn block_avx2(&mut self, samples: &[f64], e: &mut [f64]) {
        self.block::<true>(samples, e);
    }

    #[inline(always)]
    fn block<const FUSED: bool>(&mut self, samples: &[f64], e: &mut [f64]) {
        let Shape {
            order: n,
            inputs: m,
            outputs: p,
        } = self.model.shape;
        for (j, channel) in self.channels.iter_mut().enumerate() {
            let values = samples[j..].iter().step_by(m + p);
            channel.iter_mut().zip(values).for_each(|(c, v)| *c = *v);
        }
        let (inputs, outputs) = self.channels.split_at_mut(m);
        for (state, factors) in self.states.iter_mut().zip(self.model.b().chunks_exact(m)) {
            state.fill(0.0);
            for (&factor, input) in factors.iter().zip(&*inputs) {
                add_scaled::<FUSED>(state, factor, input);
            }
        }
        for (output, factors) in outputs.iter_mut().zip(self.model.d().chunks_exact(m)) {
            for (factor, input) in factors.iter().zip(&*inputs) {
                add_scaled::<FUSED>(output, -factor, input);
            }
        }
        // Common sizes are compile-time constants, so that the state stays in registers.
        match (n, p) {
            (2, 2) => self.propagate::<FUSED, _, _>([0.0; 2], [0.0; 2], e),
            (3, 2) => self.propagate::<FUSED, _, _>([0.0; 3], [0.0; 2], e),
            (4, 2) => self.propagate::<FUSED, _, _>([0.0; 4], [0.0; 2], e),
            (5, 2) => self.propagate::<FUSED, _, _>([0.0; 5], [0.0; 2], e),
            (6, 2) => self.propagate::<FUSED, _, _>([0.0; 6], [0.0; 2], e),
            _ => self.propagate::<FUSED, _, _>(vec![0.0; n], vec![0.0; p], e),
        }
    }

    /// Innovations from the products with inputs; `x` and `error` are storage for a state and an
    /// innovation.
    #[inline(always)]
    fn propagate<const FUSED: bool, X: AsMut<[f64]> + Clone, E: AsMut<[f64]>>(
        &mut self,
        mut x: X,
        mut error: E,
        innovations: &mut [f64],
    ) {
        let mut next = x.clone();
        let (x, next, error) = (x.as_mut(), next.as_mut(), error.as_mut());
        let (n, p) = (x.len(), error.len());
        let (a, c, k) = (self.model.a(), self.model.c(), self.model.k());
        let outputs = &self.channels[self.model.shape.inputs..];
        x.copy_from_slice(&self.x);
        for (t, e) in innovations.chunks_exact_mut(p).enumerate() {
            for o in 0..p {
                error[o] = outputs[o][t];
                for l in 0..n {
                    error[o] = multiply_add::<FUSED>(-c[o * n + l], x[l], error[o]);
                }
            }
            for i in 0..n {
                next[i] = std::mem::replace(&mut self.states[i][t], x[i]);
                for l in 0..n {
                    next[i] = multiply_add::<FUSED>(a[i * n + l], x[l], next[i]);
                }
                for o in 0..p {
                    next[i] = multiply_add::<FUSED>(k[i * p + o], error[o], next[i]);
                }
            }
            x.copy_from_slice(next);
            e.copy_from_slice(error);
        }
        self.x.copy_from_slice(x);
    }
}

#[inline(always)]
fn add_scaled<const FUSED: bool>(target: &mut Signal, weight: f64, source: &Signal) {
    for t in 0..BLOCK {
        target[t] = multiply_add::<FUSED>(weight, source[t], target[t]);
    }
}

/// Innovations of every record, stacked: (n_samples, p), row-major.
pub fn innovations(model: &Model, records: &[Record<'_>]) -> Vec<f64> {
    let (m, p) = (model.shape.inputs, model.shape.outputs);
    let total: usize = records.iter().map(|record| record.len).sum();
    let mut stacked = vec![0.0; total * p];
    let mut rest = &mut stacked[..];
    for (index, record) in records.iter().enumerate() {
        let mut predictor = Predictor::new(model, index);
        let (target, later) = rest.split_at_mut(record.len * p);
        rest = later;
        let blocks = record.samples.chunks(BLOCK * (m + p));
        for (samples, e) in blocks.zip(target.chunks_mut(BLOCK * p)) {
            predictor.advance(samples, e);
        }
    }
    stacked
}

/// E' E / N of stacked innovations: (p, p), row-major.
pub fn covariance(innovations: &[f64], outputs: usize) -> Vec<f64> {
    let mut sum = vec![0.0; outputs * outputs];
    for e in innovations.chunks_exact(outputs) {
        for i in 0..outputs {
            for j in 0..=i {
                sum[i * outputs + j] += e[i] * e[j];
            }
        }
    }
    let samples = (innovations.len() / outputs) as f64;
    for i in 0..outputs {
        for j in 0..=i {
            sum[i * outputs + j] /= samples;
            sum[j * outputs + i] = sum[i * outputs + j];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;

    /// The recursion by definition, for orders with and without storage of known size.
    #[test]
    fn blocks_agree_with_the_definition() {
        for order in [1, 2, 3, 6, 7] {
            let shape = Shape {
                order,
                inputs: 2,
                outputs: 3,
            };
            let number = |k: usize| ((k * k * 37 % 101) as f64 - 50.0) / 100.0;
            let lengths = [150, 64, 1];
            let size = shape.initial_state(lengths.len()).start;
            let values = (0..size).map(|k| number(k + 3) / order as f64);
            let model = Model {
                shape,
                values: values.collect(),
            };
            let samples: Vec<f64> = (0..215 * 5).map(number).collect();
            let records = split(shape, &samples, &lengths);
            let mut expected = vec![];
            let product = |matrix: &[f64], x: &[f64], i: usize| -> f64 {
                let row = &matrix[i * x.len()..][..x.len()];
                row.iter().zip(x).map(|(a, b)| a * b).sum()
            };
            for (index, record) in records.iter().enumerate() {
                let mut x = model.initial_state(index).to_vec();
                for (u, y) in record.samples.chunks(5).map(|z| z.split_at(2)) {
                    let error = |o| y[o] - product(model.c(), &x, o) - product(model.d(), u, o);
                    let e: Vec<f64> = (0..3).map(error).collect();
                    let next = |i| {
                        product(model.a(), &x, i)
                            + product(model.b(), u, i)
                            + product(model.k(), &e, i)
                    };
                    x = (0..order).map(next).collect();
                    expected.extend(e);
                }
            }
            let e = innovations(&model, &records);
            assert_eq!(e.len(), expected.len());
            for (e, expected) in e.iter().zip(&expected) {
                assert!((e - expected).abs() < 1e-13);
            }
        }
    }

    /// A first-order model whose innovations are known in closed form.
    #[test]
    fn scalar_predictor_by_hand() {
        let shape = Shape {
            order: 1,
            inputs: 1,
            outputs: 1,
        };
        let model = Model {
            shape,
            values: vec![0.5, 2.0, 1.0, 0.25, 0.1, 3.0],
        };
        let e = innovations(&model, &split(shape, &[1.0, 4.0, -1.0, 0.0], &[2]));
        let first = 4.0 - 3.0 - 0.25;
        let state = 0.5 * 3.0 + 2.0 + 0.1 * first;
        let expected = [first, 0.0 - state + 0.25];
        assert!(e.iter().zip(expected).all(|(e, x)| (e - x).abs() < 1e-15));
    }
}
