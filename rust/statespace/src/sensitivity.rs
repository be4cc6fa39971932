//! Exact derivatives of the innovations with respect to every entry of the model.
//!
//! With psi = d e / d theta and s = d x / d theta,
//!
//! ```text
//! psi[k] = -C s[k] - dC x[k] - dD u[k]
//! s[k+1] = (A - K C) s[k] + dA x[k] + dB u[k] + dK e[k] - K (dC x[k] + dD u[k])
//! ```
//!
//! Each entry of A, B and K drives a filter by one signal at one state, and each entry of an
//! initial state starts a filter. These filters run in parallel in vector lanes. Entries of C and
//! D act on the state through K with the signals of A and B, so their derivatives are sums over the
//! same filters.

use crate::linalg::solve_lower;
use crate::model::{Model, Record, Shape};
use crate::predictor::{Predictor, Signal};
use strainwave_numerics::products::{BASELINE_IS_FUSED, Part, Rows, add_products, multiply_add};

/// Number of samples whose derivatives are stored before they are summed; they fit into the
/// first-level cache.
const BLOCK: usize = 32;

/// Relative size of a unit initial state below which it is set to zero: its square is still a
/// normal number, and far below the rounding of any sum.
const MIN_RELATIVE_STATE: f64 = 1e-150;

/// Vectors have four lanes.
const LANES: usize = 4;

/// Sums J'WJ, J'We and e'We over all entries of the model and all initial states.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// (size, size), row-major.
    pub hessian: Vec<f64>,
    /// (size,).
    pub gradient: Vec<f64>,
    /// e'We.
    pub sum_of_squares: f64,
}

/// Normal equations of the whitened innovations L^-1 e, with L the lower Cholesky factor of the
/// weighting covariance.
pub fn normal_equations(
    model: &Model,
    records: &[Record<'_>],
    whitener: &[f64],
) -> NormalEquations {
    let size = model.values.len();
    let (entries, n) = (model.shape.entries(), model.shape.order);
    let mut total = NormalEquations {
        hessian: vec![0.0; size * size],
        gradient: vec![0.0; size],
        sum_of_squares: 0.0,
    };
    for (index, record) in records.iter().enumerate() {
        let mut filters = Filters::new(model, index, whitener);
        let (stride, error) = (filters.row.stride, filters.row.error);
        let width = (error + 1).next_multiple_of(LANES);
        let mut sums = vec![0.0; width * stride];
        filters.run(record, |data, count| {
            let rows = |width| Rows {
                data,
                stride,
                width,
            };
            add_products(&mut sums, rows(width), rows(stride), count, Part::Upper);
        });
        let sum = |i: usize, j: usize| sums[i.min(j) * stride + i.max(j)];
        let terms = filters.row.terms(model);
        let place = |column: usize| {
            if column < entries {
                column
            } else {
                column + index * n
            }
        };
        for (i, left) in terms.iter().enumerate() {
            for (j, right) in terms.iter().enumerate().skip(i) {
                let product: f64 = pairs(left, right).map(|(a, b, w)| w * sum(a, b)).sum();
                total.hessian[place(i) * size + place(j)] += product;
            }
            total.gradient[place(i)] += left.iter().map(|&(a, w)| w * sum(a, error)).sum::<f64>();
        }
        total.sum_of_squares += sum(error, error);
    }
    for i in 0..size {
        for j in 0..i {
            total.hessian[i * size + j] = total.hessian[j * size + i];
        }
    }
    total
}

/// Derivatives of the innovations of record `index`: (n_samples, p, entries + n), row-major.
///
/// The last n columns are those of the record's initial state.
pub fn jacobian(model: &Model, record: &Record<'_>, index: usize) -> Vec<f64> {
    let p = model.shape.outputs;
    let mut filters = Filters::new(model, index, &identity(p));
    let (stride, terms) = (filters.row.stride, filters.row.terms(model));
    let mut stacked = Vec::with_capacity(record.len * p * terms.len());
    filters.run(record, |rows, count| {
        for row in rows.chunks_exact(stride).take(count) {
            stacked.extend(
                terms
                    .iter()
                    .map(|t| t.iter().map(|&(a, w)| w * row[a]).sum::<f64>()),
            );
        }
    });
    stacked
}

/// Scores e'W psi of every sample: (n_samples, entries + n), row-major.
///
/// Used for covariances that remain valid if the innovations are not white.
pub fn scores(model: &Model, record: &Record<'_>, index: usize, whitener: &[f64]) -> Vec<f64> {
    let p = model.shape.outputs;
    let mut filters = Filters::new(model, index, whitener);
    let (stride, error) = (filters.row.stride, filters.row.error);
    let terms = filters.row.terms(model);
    let mut scores = Vec::with_capacity(record.len * terms.len());
    let mut score = vec![0.0; stride];
    filters.run(record, |rows, count| {
        for sample in rows.chunks_exact(p * stride).take(count / p) {
            score.fill(0.0);
            for row in sample.chunks_exact(stride) {
                score
                    .iter_mut()
                    .zip(row)
                    .for_each(|(s, psi)| *s += row[error] * psi);
            }
            scores.extend(
                terms
                    .iter()
                    .map(|t| t.iter().map(|&(a, w)| w * score[a]).sum::<f64>()),
            );
        }
    });
    scores
}

/// A derivative as a weighted sum of columns of a row: columns and weights.
type Terms = Vec<(usize, f64)>;

fn pairs<'a>(left: &'a Terms, right: &'a Terms) -> impl Iterator<Item = (usize, usize, f64)> + 'a {
    left.iter()
        .flat_map(|&(a, v)| right.iter().map(move |&(b, w)| (a, b, v * w)))
}

/// Layout of a row: the filters of A, B, K and the initial state; the direct terms of C and D; the
/// innovation. Each part is row-major; parts without derivatives are absent. The lanes of the
/// filters are a multiple of [`LANES`], and the other parts begin in unused lanes.
#[derive(Clone, Copy)]
struct Row {
    shape: Shape,
    lanes: usize,
    direct: usize,
    error: usize,
    stride: usize,
}

/// First filters of the entries of A, B and K, and of the initial state.
#[inline(always)]
fn first_filters(shape: Shape) -> [usize; 4] {
    let Shape {
        order: n,
        inputs: m,
        outputs: p,
    } = shape;
    [0, n * n, n * (n + m), n * (n + m + p)]
}

impl Row {
    #[inline(always)]
    fn new(shape: Shape) -> Self {
        let (n, m, p) = (shape.order, shape.inputs, shape.outputs);
        let direct = first_filters(shape)[3] + n;
        let error = direct + p * (n + m);
        let lanes = direct.next_multiple_of(LANES);
        Self {
            shape,
            lanes,
            direct,
            error,
            stride: lanes.max(error + 1).next_multiple_of(3 * LANES),
        }
    }

    /// Derivative with respect to each entry in the model's order, then to the initial state.
    fn terms(&self, model: &Model) -> Vec<Terms> {
        let Shape {
            order: n,
            inputs: m,
            outputs: p,
        } = self.shape;
        let k = model.k();
        let [of_a, of_b, of_k, of_state] = first_filters(self.shape);
        let filters = |first: usize, count: usize| (first..first + count).map(|i| vec![(i, 1.0)]);
        // An entry of C or D acts directly on output i, and through K on every state.
        let output = |i: usize, direct: usize, first: usize, width: usize| {
            let mut terms = vec![(direct, 1.0)];
            terms.extend((0..n).map(|l| (first + l * width, -k[l * p + i])));
            terms
        };
        let mut terms: Vec<Terms> = filters(of_a, n * n).collect();
        terms.extend(filters(of_b, n * m));
        for (i, j) in (0..p * n).map(|index| (index / n, index % n)) {
            terms.push(output(i, self.direct + i * n + j, of_a + j, n));
        }
        for (i, j) in (0..p * m).map(|index| (index / m, index % m)) {
            terms.push(output(i, self.direct + p * n + i * m + j, of_b + j, m));
        }
        terms.extend(filters(of_k, n * p));
        terms.extend(filters(of_state, n));
        terms
    }
}

/// The derivatives of the predictor in lanes; outputs are whitened.
struct Filters<'a> {
    model: &'a Model,
    index: usize,
    row: Row,
    /// A - K C.
    closed: Vec<f64>,
    /// -L^-1 C and -L^-1.
    output: Vec<f64>,
    whitening: Vec<f64>,
    /// State of the predictor at the current sample.
    x: Vec<f64>,
    /// (n, lanes)
    s: Vec<f64>,
    next: Vec<f64>,
}

impl<'a> Filters<'a> {
    fn new(model: &'a Model, index: usize, whitener: &[f64]) -> Self {
        let row = Row::new(model.shape);
        let (n, p) = (model.shape.order, model.shape.outputs);
        let mut s = vec![0.0; n * row.lanes];
        for i in 0..n {
            s[i * row.lanes + first_filters(model.shape)[3] + i] = 1.0;
        }
        Self {
            model,
            index,
            row,
            closed: model.predictor_matrix(),
            output: whitened(whitener, model.c(), p, n),
            whitening: whitened(whitener, &identity(p), p, p),
            x: model.initial_state(index).to_vec(),
            next: s.clone(),
            s,
        }
    }

    /// Computes the rows of a record in blocks; `receive` is called with each block, with p rows
    /// per sample, and its number of rows.
    ///
    /// The innovations come first: afterwards, no filter waits for them.
    fn run(&mut self, record: &Record<'_>, mut receive: impl FnMut(&[f64], usize)) {
        let Shape {
            inputs: m,
            outputs: p,
            ..
        } = self.model.shape;
        let mut predictor = Predictor::new(self.model, self.index);
        let mut innovations = vec![0.0; BLOCK * p];
        let mut rows = vec![0.0; BLOCK * p * self.row.stride];
        for samples in record.samples.chunks(BLOCK * (m + p)) {
            let e = &mut innovations[..samples.len() / (m + p) * p];
            predictor.advance(samples, e);
            self.clear_decayed_states();
            self.fill(samples, e, predictor.states(), &mut rows);
            receive(&rows[..e.len() * self.row.stride], e.len());
        }
    }

    /// Sets decayed contributions of the initial state to zero.
    ///
    /// The contributions of a stable predictor decay to subnormal numbers, on which processors
    /// calculate about ten times slower.
    fn clear_decayed_states(&mut self) {
        let n = self.model.shape.order;
        let offset = first_filters(self.model.shape)[3];
        let rows = self.s.chunks_exact_mut(self.row.lanes);
        for value in rows.flat_map(|row| &mut row[offset..offset + n]) {
            if value.abs() < MIN_RELATIVE_STATE {
                *value = 0.0;
            }
        }
    }

    /// Computes the rows of one block, with vector instructions if the processor has them (decided
    /// at run time on x86-64).
    fn fill(&mut self, z: &[f64], e: &[f64], states: &[Signal], rows: &mut [f64]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: both features have just been detected.
            return unsafe { self.fill_avx2(z, e, states, rows) };
        }
        self.fill_body::<BASELINE_IS_FUSED>(z, e, states, rows);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn fill_avx2(&mut self, z: &[f64], e: &[f64], states: &[Signal], rows: &mut [f64]) {
        self.fill_body::<true>(z, e, states, rows);
    }

    /// Common sizes are compile-time constants, so that their loops are unrolled.
    #[inline(always)]
    fn fill_body<const FUSED: bool>(
        &mut self,
        z: &[f64],
        e: &[f64],
        states: &[Signal],
        rows: &mut [f64],
    ) {
        let shape = self.model.shape;
        match (shape.order, shape.inputs, shape.outputs) {
            (2, 2, 2) => self.samples::<FUSED, 2, 2, 2>(z, e, states, rows),
            (3, 2, 2) => self.samples::<FUSED, 3, 2, 2>(z, e, states, rows),
            (4, 2, 2) => self.samples::<FUSED, 4, 2, 2>(z, e, states, rows),
            (5, 2, 2) => self.samples::<FUSED, 5, 2, 2>(z, e, states, rows),
            (6, 2, 2) => self.samples::<FUSED, 6, 2, 2>(z, e, states, rows),
            _ => self.samples::<FUSED, 0, 0, 0>(z, e, states, rows),
        }
    }

    /// Computes samples with sizes fixed at compile time; an order of zero selects the sizes of the
    /// model.
    #[inline(always)]
    fn samples<const FUSED: bool, const N: usize, const M: usize, const P: usize>(
        &mut self,
        z: &[f64],
        e: &[f64],
        states: &[Signal],
        rows: &mut [f64],
    ) {
        let shape = match N {
            0 => self.model.shape,
            _ => Shape {
                order: N,
                inputs: M,
                outputs: P,
            },
        };
        let row = Row::new(shape);
        let samples = z
            .chunks_exact(shape.inputs + shape.outputs)
            .zip(e.chunks_exact(shape.outputs));
        let rows = rows.chunks_exact_mut(shape.outputs * row.stride);
        for (t, ((z, e), rows)) in samples.zip(rows).enumerate() {
            let u = &z[..shape.inputs];
            for l in 0..shape.order {
                self.x[l] = states[l][t];
            }
            self.emit::<FUSED>(row, u, e, rows);
            self.step::<FUSED>(row, u, e);
        }
    }

    /// Writes the innovation and its derivatives at the current sample.
    #[inline(always)]
    fn emit<const FUSED: bool>(&mut self, row: Row, u: &[f64], e: &[f64], rows: &mut [f64]) {
        let (n, m, p) = (row.shape.order, row.shape.inputs, row.shape.outputs);
        let (lanes, direct, error) = (row.lanes, row.direct, row.error);
        for (o, row) in rows.chunks_exact_mut(row.stride).enumerate() {
            combine::<FUSED>(
                &self.output[o * n..][..n],
                &self.s,
                lanes,
                &mut row[..lanes],
            );
            row[error] = 0.0;
            for i in 0..p {
                let weight = self.whitening[o * p + i];
                for j in 0..n {
                    row[direct + i * n + j] = weight * self.x[j];
                }
                for j in 0..m {
                    row[direct + p * n + i * m + j] = weight * u[j];
                }
                row[error] -= weight * e[i];
            }
        }
    }

    /// Advances states and derivatives to the next sample.
    #[inline(always)]
    fn step<const FUSED: bool>(&mut self, row: Row, u: &[f64], e: &[f64]) {
        let Shape {
            order: n,
            inputs: m,
            outputs: p,
        } = row.shape;
        let (lanes, first) = (row.lanes, first_filters(row.shape));
        for (l, row) in self.next.chunks_exact_mut(lanes).enumerate() {
            combine::<FUSED>(&self.closed[l * n..][..n], &self.s, lanes, row);
            for (index, signal) in [&self.x[..n], &u[..m], &e[..p]].into_iter().enumerate() {
                let width = signal.len();
                row[first[index] + l * width..][..width]
                    .iter_mut()
                    .zip(signal)
                    .for_each(|(r, v)| *r += v);
            }
        }
        std::mem::swap(&mut self.s, &mut self.next);
    }
}

/// target = weights' s, for s of (n, lanes).
#[inline(always)]
fn combine<const FUSED: bool>(weights: &[f64], s: &[f64], lanes: usize, target: &mut [f64]) {
    for (chunk, target) in target.chunks_exact_mut(LANES).enumerate() {
        let mut sum = [0.0; LANES];
        for j in 0..weights.len() {
            let row: &[f64; LANES] = s[j * lanes + chunk * LANES..][..LANES].try_into().unwrap();
            for lane in 0..LANES {
                sum[lane] = multiply_add::<FUSED>(weights[j], row[lane], sum[lane]);
            }
        }
        target.copy_from_slice(&sum);
    }
}

fn identity(size: usize) -> Vec<f64> {
    (0..size * size)
        .map(|entry| f64::from(u8::from(entry / size == entry % size)))
        .collect()
}

/// -L^-1 M for a (p, columns) matrix.
fn whitened(factor: &[f64], matrix: &[f64], p: usize, columns: usize) -> Vec<f64> {
    let mut result = vec![0.0; p * columns];
    let mut column = vec![0.0; p];
    for j in 0..columns {
        (0..p).for_each(|i| column[i] = -matrix[i * columns + j]);
        solve_lower(factor, p, &mut column);
        (0..p).for_each(|i| result[i * columns + j] = column[i]);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;
    use crate::predictor;

    /// Derivatives of an unstable plant with a stable predictor agree with differences of the
    /// innovations, over a record in which A amplifies rounding by more than 1e16.
    #[test]
    fn derivatives_of_an_unstable_plant_agree_with_differences() {
        let shape = Shape {
            order: 2,
            inputs: 1,
            outputs: 1,
        };
        let values = vec![
            1.2, 0.1, 0.0, 0.8, 0.3, 0.5, 1.0, 0.4, 0.2, 0.7, 0.1, 0.5, -0.2,
        ];
        let mut model = Model { shape, values };
        let samples: Vec<f64> = (0..2 * 400)
            .map(|k| f64::from(k * k * 37 % 101) / 50.0 - 1.0)
            .collect();
        let records = split(shape, &samples, &[400]);
        let derivatives = jacobian(&model, &records[0], 0);
        let size = model.values.len();
        for entry in 0..size {
            let value = model.values[entry];
            let mut at = |change: f64| {
                model.values[entry] = value + change;
                predictor::innovations(&model, &records)
            };
            let (above, below) = (at(1e-5), at(-1e-5));
            model.values[entry] = value;
            for (k, row) in derivatives.chunks_exact(size).enumerate() {
                let difference = (above[k] - below[k]) / 2e-5;
                // error of central differences
                assert!((row[entry] - difference).abs() < 1e-6 * (1.0 + difference.abs()));
            }
        }
    }
}
