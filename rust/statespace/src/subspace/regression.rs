//! Model from the regression of outputs and next states on states and inputs.

use super::{Options, RANK_TOLERANCE, States, Subspace, add_scaled, block, dot};
use crate::linalg::{product, transposed};
use crate::model::{Model, Record, Shape};
use crate::steady_state::{Noise, balance, innovations_gain, stabilising_gain};
use strainwave_numerics::{singular, triangular};

impl Subspace {
    /// Regression of outputs and next states on states and inputs; K follows from the residuals.
    pub(super) fn regress(
        &self,
        records: &[Record<'_>],
        states: &States,
        options: &Options<'_>,
    ) -> Model {
        let (m, p, n) = (self.shape.inputs, self.shape.outputs, states.order);
        let (factor, _) = self.regression(records);
        // inputs with feedthrough first, so that their columns end the regressors of the outputs
        let mut inputs: Vec<usize> = (0..m).collect();
        inputs.sort_by_key(|&j| !options.feedthrough[j]);
        let direct = options.feedthrough.iter().filter(|&&flag| flag).count();
        let mut table = self.regressors_and_targets(factor, states, &inputs);
        let (regressors, targets) = (n + m, n + p);
        let columns = regressors + targets;
        let mut coefficients = vec![0.0; regressors * targets];
        if let Some((a, c)) = &states.given {
            for (i, row) in coefficients.chunks_exact_mut(targets).take(n).enumerate() {
                (0..n).for_each(|k| row[k] = a[k * n + i]);
                (0..p).for_each(|o| row[n + o] = c[o * n + i]);
            }
            subtract_prediction(&mut table, targets, columns, &coefficients);
            for row in table.chunks_exact_mut(columns) {
                row[..n].fill(0.0); // the least-norm solution has no further multiple of the states
            }
        }
        let reduced = triangular::factor(&table, columns);
        let mut changes = vec![0.0; regressors * targets];
        for (count, first, width) in [(regressors, 0, n), (n + direct, n, p)] {
            let square = block(&reduced, columns, 0..count, 0..count);
            let from = regressors + first;
            let right = block(&reduced, columns, 0..count, from..from + width);
            let solution = singular::solve(&square, count, &right, RANK_TOLERANCE);
            for (row, source) in changes
                .chunks_exact_mut(targets)
                .zip(solution.chunks_exact(width))
            {
                row[first..][..width].copy_from_slice(source);
            }
        }
        subtract_prediction(&mut table, targets, columns, &changes);
        coefficients
            .iter_mut()
            .zip(&changes)
            .for_each(|(c, change)| *c += change);
        let residuals = block(
            &table,
            columns,
            0..table.len() / columns,
            regressors..columns,
        );
        let samples: usize = records.iter().map(|record| record.len).sum();
        let mut noise = product(
            &transposed(&residuals, table.len() / columns),
            &residuals,
            targets,
        );
        noise.iter_mut().for_each(|entry| *entry /= samples as f64);
        (n..targets).for_each(|o| noise[o * targets + o] += options.floor);
        self.model(records.len(), &coefficients, &inputs, &noise)
    }

    /// Rows [x, u, next x, y] of the data that R represents, with permuted inputs.
    fn regressors_and_targets(
        &self,
        factor: &[f64],
        states: &States,
        inputs: &[usize],
    ) -> Vec<f64> {
        let (m, p, n) = (self.shape.inputs, self.shape.outputs, states.order);
        let (lead, width, history) = (self.lead(), self.width(), self.past * self.width());
        let mut table = Vec::with_capacity((lead + p) * (n + m + n + p));
        for row in factor.chunks_exact(lead + p) {
            let (u, z, y) = (&row[..m], &row[m..lead], &row[lead..]);
            let states = || states.of_past.chunks_exact(history);
            table.extend(states().map(|state| dot(state, z)));
            table.extend(inputs.iter().map(|&j| u[j]));
            // [u[k], y[k]] is the newest sample of the next state, and the oldest one drops out
            table.extend(states().map(|state| {
                dot(&state[..m], u) + dot(&state[m..width], y) + dot(&state[width..], z)
            }));
            table.extend_from_slice(y);
        }
        table
    }

    /// Balanced model from the coefficients of [x, u] in [next x, y], and the covariance of the
    /// residuals of these.
    fn model(
        &self,
        records: usize,
        coefficients: &[f64],
        inputs: &[usize],
        noise: &[f64],
    ) -> Model {
        let (m, p) = (self.shape.inputs, self.shape.outputs);
        let n = coefficients.len() / (noise.len().isqrt()) - m;
        let targets = n + p;
        let shape = Shape {
            order: n,
            ..self.shape
        };
        let mut values = vec![0.0; shape.initial_state(records).start];
        for (k, row) in coefficients.chunks_exact(targets).enumerate() {
            let (a, c) = match k.checked_sub(n) {
                None => (shape.a().start + k, shape.c().start + k),
                Some(j) => (shape.b().start + inputs[j], shape.d().start + inputs[j]),
            };
            let step = if k < n { n } else { m };
            (0..n).for_each(|i| values[a + i * step] = row[i]);
            (0..p).for_each(|o| values[c + o * step] = row[n + o]);
        }
        let mut model = Model { shape, values };
        let part = |rows, columns| block(noise, targets, rows, columns);
        let noise = Noise {
            state: &part(0..n, 0..n),
            cross: &part(0..n, n..targets),
            output: &part(n..targets, n..targets),
        };
        let (a, c) = (model.a(), model.c());
        let (gain, covariance) = innovations_gain(a, c, noise, n, p)
            .unwrap_or_else(|| (vec![f64::NAN; n * p], vec![f64::NAN; p * p]));
        let gain = stabilising_gain(a, c, gain, &covariance, n, p);
        model.values[shape.k()].copy_from_slice(&gain);
        balance(&mut model);
        model
    }
}

/// Subtracts the products of the first columns of each row with coefficients from its other columns.
fn subtract_prediction(table: &mut [f64], targets: usize, columns: usize, coefficients: &[f64]) {
    for row in table.chunks_exact_mut(columns) {
        let (regressors, rest) = row.split_at_mut(columns - targets);
        for (weight, source) in regressors.iter().zip(coefficients.chunks_exact(targets)) {
            add_scaled(rest, -weight, source);
        }
    }
}
