//! One-step predictor: innovations from data.

use crate::model::{Model, Record, Shape};

/// Appends the innovations e[k] = y[k] - C x[k] - D u[k] of record `index` to `innovations`.
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
    let mut run = Run {
        model,
        record,
        index,
        innovations,
    };
    // Common sizes are compile-time constants, so that their loops are unrolled.
    match (n, m, p) {
        (2, 2, 2) => run.append([2, 2, 2], [0.0; 2], [0.0; 2]),
        (3, 2, 2) => run.append([3, 2, 2], [0.0; 3], [0.0; 2]),
        (4, 2, 2) => run.append([4, 2, 2], [0.0; 4], [0.0; 2]),
        (5, 2, 2) => run.append([5, 2, 2], [0.0; 5], [0.0; 2]),
        (6, 2, 2) => run.append([6, 2, 2], [0.0; 6], [0.0; 2]),
        _ => run.append([n, m, p], vec![0.0; n], vec![0.0; p]),
    }
}

struct Run<'a> {
    model: &'a Model,
    record: &'a Record<'a>,
    index: usize,
    innovations: &'a mut Vec<f64>,
}

impl Run<'_> {
    /// Appends the innovations of a model of given sizes; `x` and `e` are storage for a state and an
    /// innovation.
    #[inline(always)]
    fn append<X: AsMut<[f64]> + Clone, E: AsMut<[f64]>>(
        &mut self,
        [n, m, p]: [usize; 3],
        mut x: X,
        mut e: E,
    ) {
        let model = self.model;
        let (a, b, c, d, k) = (model.a(), model.b(), model.c(), model.d(), model.k());
        x.as_mut().copy_from_slice(model.initial_state(self.index));
        let mut next = x.clone();
        let inputs = self.record.inputs.chunks_exact(m);
        for (u, y) in inputs.zip(self.record.outputs.chunks_exact(p)) {
            let (x_now, x_next, e) = (
                &x.as_mut()[..n],
                &mut next.as_mut()[..n],
                &mut e.as_mut()[..p],
            );
            for o in 0..p {
                e[o] = y[o] - dot(&c[o * n..][..n], x_now) - dot(&d[o * m..][..m], u);
            }
            for i in 0..n {
                x_next[i] = dot(&a[i * n..][..n], x_now)
                    + dot(&b[i * m..][..m], u)
                    + dot(&k[i * p..][..p], e);
            }
            std::mem::swap(&mut x, &mut next);
            self.innovations.extend_from_slice(e);
        }
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

#[inline]
fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;

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
        assert_eq!(e, vec![first, 0.0 - state + 0.25]);
    }
}
