//! One-step predictor: innovations from data.

use crate::model::{Model, Record, Shape};
use strainwave_numerics::products::{BASELINE_IS_FUSED, multiply_add};

/// Samples of a block; its signals and states fit into the first-level cache.
const BLOCK: usize = 64;

/// Values of one channel or state in a block.
type Signal = [f64; BLOCK];

/// Appends the innovations e[k] = y[k] - C x[k] - D u[k] of record `index` to `innovations`.
///
/// The states follow from x[k+1] = (A - K C) x[k] + (B - K D) u[k] + K y[k]: only the product with
/// A - K C waits for the previous sample.
pub fn append_innovations(
    model: &Model,
    record: &Record<'_>,
    index: usize,
    innovations: &mut Vec<f64>,
) {
    let Shape {
        order: n,
        inputs: m,
        outputs: p,
    } = model.shape;
    let mut of_inputs = model.b().to_vec();
    for (i, j) in (0..n * m).map(|at| (at / m, at % m)) {
        for o in 0..p {
            of_inputs[i * m + j] -= model.k()[i * p + o] * model.d()[o * m + j];
        }
    }
    let mut run = Run {
        model,
        closed: model.predictor_matrix(),
        of_inputs,
        channels: vec![[0.0; BLOCK]; m + p],
        states: vec![[0.0; BLOCK]; n],
        x: model.initial_state(index).to_vec(),
    };
    let first = innovations.len();
    innovations.resize(first + record.len * p, 0.0);
    let outputs = record.outputs.chunks(BLOCK * p);
    let targets = innovations[first..].chunks_mut(BLOCK * p);
    for ((u, y), e) in record.inputs.chunks(BLOCK * m).zip(outputs).zip(targets) {
        run.block(u, y, e);
    }
}

struct Run<'a> {
    model: &'a Model,
    /// A - K C and B - K D.
    closed: Vec<f64>,
    of_inputs: Vec<f64>,
    /// Inputs and outputs; the latter become innovations.
    channels: Vec<Signal>,
    states: Vec<Signal>,
    x: Vec<f64>,
}

impl Run<'_> {
    /// Computes the innovations of one block, with vectors if the processor has them (decided at run
    /// time on x86-64).
    fn block(&mut self, u: &[f64], y: &[f64], e: &mut [f64]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: both features have just been detected.
            return unsafe { self.block_avx2(u, y, e) };
        }
        self.block_body::<BASELINE_IS_FUSED>(u, y, e);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn block_avx2(&mut self, u: &[f64], y: &[f64], e: &mut [f64]) {
        self.block_body::<true>(u, y, e);
    }

    #[inline(always)]
    fn block_body<const FUSED: bool>(&mut self, u: &[f64], y: &[f64], e: &mut [f64]) {
        let Shape {
            order: n,
            inputs: m,
            outputs: p,
        } = self.model.shape;
        let (inputs, outputs) = self.channels.split_at_mut(m);
        for (source, channels) in [(u, &mut *inputs), (y, &mut *outputs)] {
            let count = channels.len();
            for (j, channel) in channels.iter_mut().enumerate() {
                let values = source[j..].iter().step_by(count);
                channel.iter_mut().zip(values).for_each(|(c, v)| *c = *v);
            }
        }
        let k = self.model.k();
        for (i, state) in self.states.iter_mut().enumerate() {
            state.fill(0.0);
            let weights = self.of_inputs[i * m..][..m].iter().chain(&k[i * p..][..p]);
            for (&weight, channel) in weights.zip(inputs.iter().chain(&*outputs)) {
                add_scaled::<FUSED>(state, weight, channel);
            }
        }
        let samples = u.len() / m;
        // Common orders are compile-time constants, so that the state stays in registers.
        match n {
            2 => self.advance::<FUSED, _>([0.0; 2], samples),
            3 => self.advance::<FUSED, _>([0.0; 3], samples),
            4 => self.advance::<FUSED, _>([0.0; 4], samples),
            5 => self.advance::<FUSED, _>([0.0; 5], samples),
            6 => self.advance::<FUSED, _>([0.0; 6], samples),
            _ => self.advance::<FUSED, _>(vec![0.0; n], samples),
        }
        let (inputs, outputs) = self.channels.split_at_mut(m);
        for (o, error) in outputs.iter_mut().enumerate() {
            for (weight, input) in self.model.d()[o * m..][..m].iter().zip(&*inputs) {
                add_scaled::<FUSED>(error, -weight, input);
            }
            for (weight, state) in self.model.c()[o * n..][..n].iter().zip(&self.states) {
                add_scaled::<FUSED>(error, -weight, state);
            }
            let targets = e[o..].iter_mut().step_by(p);
            targets.zip(&*error).for_each(|(e, error)| *e = *error);
        }
    }

    /// Replaces what drives the states by the states; `x` is storage for one of them.
    #[inline(always)]
    fn advance<const FUSED: bool, X: AsMut<[f64]> + Clone>(&mut self, mut x: X, samples: usize) {
        let mut next = x.clone();
        let (x, next) = (x.as_mut(), next.as_mut());
        let n = x.len();
        x.copy_from_slice(&self.x);
        for t in 0..samples {
            for i in 0..n {
                let mut sum = std::mem::replace(&mut self.states[i][t], x[i]);
                for l in 0..n {
                    sum = multiply_add::<FUSED>(self.closed[i * n + l], x[l], sum);
                }
                next[i] = sum;
            }
            x.copy_from_slice(next);
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
    let total: usize = records.iter().map(|record| record.len).sum();
    let mut stacked = Vec::with_capacity(total * model.shape.outputs);
    for (index, record) in records.iter().enumerate() {
        append_innovations(model, record, index, &mut stacked);
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
            let signal = |width: usize| (0..215 * width).map(number).collect::<Vec<_>>();
            let (u, y) = (signal(2), signal(3));
            let records = split(shape, &u, &y, &lengths);
            let mut expected = vec![];
            let product = |matrix: &[f64], x: &[f64], i: usize| -> f64 {
                let row = &matrix[i * x.len()..][..x.len()];
                row.iter().zip(x).map(|(a, b)| a * b).sum()
            };
            for (index, record) in records.iter().enumerate() {
                let mut x = model.initial_state(index).to_vec();
                for (u, y) in record.inputs.chunks(2).zip(record.outputs.chunks(3)) {
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
        let (u, y) = ([1.0, -1.0], [4.0, 0.0]);
        let e = innovations(&model, &split(shape, &u, &y, &[2]));
        let first = 4.0 - 3.0 - 0.25;
        let state = 0.5 * 3.0 + 2.0 + 0.1 * first;
        let expected = [first, 0.0 - state + 0.25];
        assert!(e.iter().zip(expected).all(|(e, x)| (e - x).abs() < 1e-15));
    }
}
