//! Linear least squares for B, D and the initial states of a model with given A, C and K.
//!
//! The innovations are linear in these entries. With F = A - K C, their derivatives need one filter
//! per output o and input j, whose state is the row vector
//!
//! ```text
//! X_oj[k+1] = X_oj[k] F + C_o u_j[k]
//! d e_o / d B_ij = -(X_oj)_i,   d e_o / d x0 = -C_o F^k,
//! d e_o / d D_qj = X_oj K_q - (o = q) u_j
//! ```
//!
//! so one pass over the data gives the products of all filter states, inputs and innovations. These
//! sums hold for every weighting of the outputs, and for the covariance of the innovations that
//! belong to a solution.

use crate::linalg::{cholesky, inverse, solve_lower};
use crate::model::{Model, Record, Shape};
use crate::predictor::{self, BLOCK, Predictor};
use strainwave_numerics::products::{BASELINE_IS_FUSED, Part, Rows, add_products, multiply_add};
use strainwave_numerics::singular;

/// Lanes of a vector with AVX-512; the states of all filters of an output side by side.
const LANES: usize = 8;

/// Columns of a row of products are a multiple, so that no product falls to a narrow tile.
const WIDTH_STEP: usize = 12;

/// The same for the left factors of the products.
const HEIGHT_STEP: usize = 4;

/// Smallest singular value of the scaled normal equations, relative to the largest.
const RANK_TOLERANCE: f64 = 1e-14;

/// Smallest share of the innovations in the terms that they are the sum of, for which their
/// covariance follows from the sums: its relative error is then about 1e-16 / 1e-8.
const MIN_SQUARE_SHARE: f64 = 1e-8;

/// Smallest determinant of the correlations of the innovations for which sums of unweighted outputs
/// are weighted afterwards; the weighting multiplies rounding by the reciprocal.
const MIN_CORRELATION_DETERMINANT: f64 = 1e-4;

/// Innovations of scaled outputs that exceed this limit diverge.
const DIVERGENCE_RATIO: f64 = 1e3;

/// Contribution of an initial state, relative to its start, below which it is zero: far below
/// rounding of the innovations.
const MIN_RELATIVE_STATE: f64 = 1e-20;

/// Size of a filter state below which it is zero: its square is still a normal number, and far below
/// the rounding of any sum.
const MIN_STATE: f64 = 1e-150;

/// Entries that are estimated.
#[derive(Clone, Copy)]
pub enum Entries<'a> {
    /// B, the columns of D with a flag, and the initial states.
    Plant(&'a [bool]),
    /// The initial states.
    InitialStates,
}

/// Replaces the estimated entries of the model by their least-squares values. D without estimated
/// columns is zero if B is estimated.
///
/// All outputs have the same weight. With `weighted`, a second solution has the inverse covariance
/// of the innovations of the first one as weighting; its value is a variance that regularises the
/// covariance.
///
/// Returns whether the sums are finite; otherwise the predictor overflows over a record, and the
/// entries are zero.
pub fn estimate(
    model: &mut Model,
    records: &[Record<'_>],
    entries: Entries<'_>,
    weighted: Option<f64>,
) -> bool {
    let p = model.shape.outputs;
    let problem = Problem::new(model, records.len(), entries);
    if let Entries::Plant(_) = entries {
        model.values[model.shape.d()].fill(0.0);
    }
    problem.indices.iter().for_each(|&i| model.values[i] = 0.0);
    let origin = model.clone();
    let sums = problem.sums(&origin, records, &identity(p));
    let Some(step) = problem.solve(&sums, &identity(p)) else {
        return false;
    };
    problem.set(model, &step);
    let Some(floor) = weighted else {
        return true;
    };
    let covariance = problem.covariance(&sums, &step);
    // if the predictor diverges, the first solution remains
    let Some(mut covariance) = covariance.or_else(|| direct_covariance(model, records)) else {
        return true;
    };
    (0..p).for_each(|o| covariance[o * p + o] += floor);
    let Some(factor) = cholesky(&covariance, p) else {
        return true;
    };
    let pivots: f64 = (0..p).map(|o| factor[o * p + o].powi(2)).product();
    let variances: f64 = (0..p).map(|o| covariance[o * p + o]).product();
    let step = match inverse(covariance, p) {
        Some((weights, _)) if pivots > MIN_CORRELATION_DETERMINANT * variances => {
            problem.solve(&sums, &weights)
        }
        _ => problem.solve(&problem.sums(&origin, records, &factor), &identity(p)),
    };
    if let Some(step) = step {
        problem.set(model, &step);
    }
    true
}

/// Covariance of the innovations from a pass over the data; `None` if they diverge.
fn direct_covariance(model: &Model, records: &[Record<'_>]) -> Option<Vec<f64>> {
    let innovations = predictor::innovations(model, records);
    let is_bounded = innovations.iter().all(|e| e.abs() < DIVERGENCE_RATIO);
    is_bounded.then(|| predictor::covariance(&innovations, model.shape.outputs))
}

/// Least-norm solution of symmetric equations with a unit diagonal; `None` if they are not finite.
fn solve_scaled(mut hessian: Vec<f64>, mut right: Vec<f64>) -> Option<Vec<f64>> {
    let size = right.len();
    if !hessian.iter().chain(&right).all(|entry| entry.is_finite()) {
        return None;
    }
    // an entry without effect has a zero row; its infinite scale makes it zero
    let scale: Vec<f64> = (0..size)
        .map(|i| match hessian[i * size + i] {
            square if square > 0.0 => square.sqrt(),
            _ => f64::INFINITY,
        })
        .collect();
    for i in 0..size {
        right[i] /= scale[i];
        for j in 0..size {
            hessian[i * size + j] /= scale[i] * scale[j];
        }
    }
    let solution = singular::solve(&hessian, size, &right, RANK_TOLERANCE);
    Some(solution.iter().zip(scale).map(|(x, s)| x / s).collect())
}

/// Layout of the estimated entries and of the products.
struct Problem {
    shape: Shape,
    /// Indices of the estimated entries in the model's vector: B, D, the initial states.
    indices: Vec<usize>,
    /// Number of estimated entries of B and D.
    shared: usize,
    /// Number of inputs with filters.
    driven: usize,
    /// Inputs with estimated feedthrough.
    direct: Vec<usize>,
}

/// A weighted sum of columns.
type Terms = Vec<(usize, f64)>;

struct Sums {
    /// For every whitened output, its derivatives with respect to the shared entries and the
    /// initial state of a record.
    derivatives: Vec<Vec<Terms>>,
    /// Products (columns, columns) of every record.
    products: Vec<Vec<f64>>,
    /// Number of samples of the records, if the products contain all of them.
    samples: Option<usize>,
}

impl Problem {
    fn new(model: &Model, records: usize, entries: Entries<'_>) -> Self {
        let shape = model.shape;
        let (n, m, p) = (shape.order, shape.inputs, shape.outputs);
        let (driven, direct, mut indices) = match entries {
            Entries::Plant(flags) => {
                let direct = (0..m).filter(|&j| flags[j]).collect();
                (m, direct, shape.b().collect())
            }
            Entries::InitialStates => (0, vec![], vec![]),
        };
        let feedthrough = |q: usize| direct.iter().map(move |j| shape.d().start + q * m + j);
        indices.extend((0..p).flat_map(feedthrough));
        let shared = indices.len();
        indices.extend(shape.entries()..shape.entries() + records * n);
        Self {
            shape,
            indices,
            shared,
            driven,
            direct,
        }
    }

    /// Columns of one state: the filters of every output, by inputs and the initial state.
    fn filters(&self) -> usize {
        self.shape.outputs * (self.driven + 1)
    }

    /// First column of the inputs with feedthrough; the states come before them.
    fn input_columns(&self) -> usize {
        self.shape.order * self.filters()
    }

    /// First column of the whitened innovations, the last ones.
    fn error_columns(&self) -> usize {
        self.input_columns() + self.direct.len()
    }

    fn columns(&self) -> usize {
        self.error_columns() + self.shape.outputs
    }

    /// Derivatives of the whitened output `o`.
    fn derivatives(&self, model: &Model, whitening: &[f64], o: usize) -> Vec<Terms> {
        let (n, p) = (self.shape.order, self.shape.outputs);
        let state = |i: usize, j: usize| i * self.filters() + o * (self.driven + 1) + j;
        let mut all = Vec::with_capacity(self.shared + n);
        for i in 0..n {
            all.extend((0..self.driven).map(|j| vec![(state(i, j), -1.0)]));
        }
        for q in 0..p {
            for (index, &j) in self.direct.iter().enumerate() {
                let mut terms: Terms = (0..n)
                    .map(|i| (state(i, j), model.k()[i * p + q]))
                    .collect();
                terms.push((self.input_columns() + index, -whitening[o * p + q]));
                all.push(terms);
            }
        }
        all.extend((0..n).map(|i| vec![(state(i, self.driven), -1.0)]));
        all
    }

    /// Products for every record; the outputs are multiplied by the inverse of `whitener`.
    fn sums(&self, model: &Model, records: &[Record<'_>], whitener: &[f64]) -> Sums {
        let p = self.shape.outputs;
        let whitening = inverse_lower(whitener, p);
        let derivatives = (0..p).map(|o| self.derivatives(model, &whitening, o));
        let columns = self.columns();
        let width = columns.next_multiple_of(WIDTH_STEP);
        let height = columns.next_multiple_of(HEIGHT_STEP);
        let mut samples = Some(0);
        let parts = records.iter().enumerate().map(|(index, record)| {
            let mut filters = Filters::new(self, model, &whitening);
            let predictor = Predictor::new(model, index);
            let mut products = vec![0.0; height * width];
            let is_complete = filters.run(record, predictor, |data, stride, count| {
                let rows = |width| Rows {
                    data,
                    stride,
                    width,
                };
                add_products(&mut products, rows(height), rows(width), count, Part::Upper);
            });
            samples = samples.filter(|_| is_complete).map(|sum| sum + record.len);
            let places = (0..columns * columns).map(|at| (at / columns, at % columns));
            let entries = places.map(|(i, j)| products[i.min(j) * width + i.max(j)]);
            entries.collect()
        });
        let products = parts.collect();
        Sums {
            derivatives: derivatives.collect(),
            products,
            samples,
        }
    }

    /// Index in a solution of an entry of `derivatives` for a record.
    fn place(&self, entry: usize, record: usize) -> usize {
        if entry < self.shared {
            entry
        } else {
            entry + record * self.shape.order
        }
    }

    fn set(&self, model: &mut Model, step: &[f64]) {
        for (&index, &value) in self.indices.iter().zip(step) {
            model.values[index] = value;
        }
    }

    /// Minimum of the sum of squares of the innovations with a weighting matrix; `None` if the sums
    /// are not finite.
    fn solve(&self, sums: &Sums, weights: &[f64]) -> Option<Vec<f64>> {
        let (p, size, columns) = (self.shape.outputs, self.indices.len(), self.columns());
        let (mut hessian, mut gradient) = (vec![0.0; size * size], vec![0.0; size]);
        for (record, products) in sums.products.iter().enumerate() {
            for (o, left) in sums.derivatives.iter().enumerate() {
                for (k, terms) in left.iter().enumerate() {
                    let row = combine(products, columns, terms);
                    let k = self.place(k, record);
                    for (q, right) in sums.derivatives.iter().enumerate() {
                        let weight = weights[o * p + q];
                        gradient[k] -= weight * row[self.error_columns() + q];
                        for (l, terms) in right.iter().enumerate() {
                            let sum: f64 = terms.iter().map(|&(c, w)| w * row[c]).sum();
                            hessian[k * size + self.place(l, record)] += weight * sum;
                        }
                    }
                }
            }
        }
        solve_scaled(hessian, gradient)
    }

    /// Covariance of the innovations after a step from unweighted sums; `None` if the sums are not
    /// complete or the innovations are a small difference of large terms.
    fn covariance(&self, sums: &Sums, step: &[f64]) -> Option<Vec<f64>> {
        let samples = sums.samples? as f64;
        let (p, columns) = (self.shape.outputs, self.columns());
        let mut total = vec![0.0; p * p];
        let mut largest = vec![0.0; p];
        for (record, products) in sums.products.iter().enumerate() {
            let innovation = |o: usize| -> Terms {
                let mut weights = vec![0.0; columns];
                weights[self.error_columns() + o] = 1.0;
                for (k, terms) in sums.derivatives[o].iter().enumerate() {
                    let step = step[self.place(k, record)];
                    terms.iter().for_each(|&(c, w)| weights[c] += w * step);
                }
                weights.into_iter().enumerate().collect()
            };
            let innovations: Vec<Terms> = (0..p).map(innovation).collect();
            for (o, left) in innovations.iter().enumerate() {
                let size = |&(c, w): &(usize, f64)| w.abs() * products[c * columns + c].sqrt();
                largest[o] += left.iter().map(size).sum::<f64>().powi(2);
                let row = combine(products, columns, left);
                for (q, right) in innovations.iter().enumerate() {
                    total[o * p + q] += right.iter().map(|&(c, w)| w * row[c]).sum::<f64>();
                }
            }
        }
        let is_accurate = (0..p).all(|o| total[o * p + o] > MIN_SQUARE_SHARE * largest[o]);
        let is_bounded = (0..p).all(|o| total[o * p + o] < samples * DIVERGENCE_RATIO.powi(2));
        (is_accurate && is_bounded).then(|| total.iter().map(|sum| sum / samples).collect())
    }
}

/// Weighted sum of the rows of a matrix.
fn combine(matrix: &[f64], columns: usize, terms: &[(usize, f64)]) -> Vec<f64> {
    let mut row = vec![0.0; columns];
    for &(source, weight) in terms {
        let source = &matrix[source * columns..][..columns];
        row.iter_mut()
            .zip(source)
            .for_each(|(r, s)| *r += weight * s);
    }
    row
}

/// The filters of one record.
struct Filters {
    shape: Shape,
    /// Columns of a state, and vectors that hold them.
    filters: usize,
    vectors: usize,
    driven: usize,
    direct: Vec<usize>,
    stride: usize,
    /// F = A - K C and the inverse of the whitener.
    closed: Vec<f64>,
    whitening: Vec<f64>,
    /// (vectors, n): states of the filters, and the factors of the inputs that drive them.
    states: Vec<Vector>,
    drive: Vec<Vector>,
    /// Size of the states at which the contributions of the initial state have decayed.
    decayed: f64,
}

type Vector = [f64; LANES];

impl Filters {
    fn new(problem: &Problem, model: &Model, whitening: &[f64]) -> Self {
        let shape = model.shape;
        let (n, p) = (shape.order, shape.outputs);
        let (filters, per_output) = (problem.filters(), problem.driven + 1);
        let vectors = filters.div_ceil(LANES);
        let mut states = vec![[0.0; LANES]; vectors * n];
        let mut drive = states.clone();
        for (o, j) in (0..filters).map(|at| (at / per_output, at % per_output)) {
            let is_driven = j < problem.driven;
            let target = if is_driven { &mut drive } else { &mut states };
            let column = o * per_output + j;
            for i in 0..n {
                let products = (0..p).map(|q| whitening[o * p + q] * model.c()[q * n + i]);
                target[column / LANES * n + i][column % LANES] = products.sum();
            }
        }
        Self {
            shape,
            filters,
            vectors,
            driven: problem.driven,
            direct: problem.direct.clone(),
            stride: problem.columns().next_multiple_of(WIDTH_STEP) + LANES,
            closed: model.predictor_matrix(),
            whitening: whitening.to_vec(),
            decayed: MIN_RELATIVE_STATE * largest(&states),
            states,
            drive,
        }
    }

    /// Computes the rows of a record in blocks; `receive` is called with the rows of each block,
    /// their stride and their number.
    ///
    /// Without inputs, the rows after the decay of the initial state have no derivatives and are
    /// left out. Returns whether all rows are computed.
    fn run(
        &mut self,
        record: &Record<'_>,
        mut predictor: Predictor<'_>,
        mut receive: impl FnMut(&[f64], usize, usize),
    ) -> bool {
        let (p, width) = (self.shape.outputs, self.shape.inputs + self.shape.outputs);
        let mut innovations = vec![0.0; BLOCK * p];
        let mut rows = vec![0.0; BLOCK * self.stride];
        let mut signals = vec![ZEROS; BLOCK];
        for samples in record.samples.chunks(BLOCK * width) {
            if self.driven == 0 && largest(&self.states) <= self.decayed {
                return false;
            }
            // processors calculate about ten times slower on subnormal numbers
            for value in self.states.as_flattened_mut() {
                if value.abs() < MIN_STATE {
                    *value = 0.0;
                }
            }
            let count = samples.len() / width;
            let e = &mut innovations[..count * p];
            predictor.advance(samples, e);
            self.fill(samples, e, &mut rows, &mut signals);
            receive(&rows, self.stride, count);
        }
        true
    }

    /// Computes the rows of one block, with vectors if the processor has them (decided at run time
    /// on x86-64).
    fn fill(&mut self, z: &[f64], e: &[f64], rows: &mut [f64], signals: &mut [Vector]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: all features have just been detected.
                return unsafe { self.fill_avx512(z, e, rows, signals) };
            }
            // SAFETY: both features have just been detected.
            return unsafe { self.fill_avx2(z, e, rows, signals) };
        }
        self.fill_body::<BASELINE_IS_FUSED>(z, e, rows, signals);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,avx512f")]
    fn fill_avx512(&mut self, z: &[f64], e: &[f64], rows: &mut [f64], signals: &mut [Vector]) {
        self.fill_body::<true>(z, e, rows, signals);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn fill_avx2(&mut self, z: &[f64], e: &[f64], rows: &mut [f64], signals: &mut [Vector]) {
        self.fill_body::<true>(z, e, rows, signals);
    }

    /// Common orders are compile-time constants, so that their states stay in registers.
    #[inline(always)]
    fn fill_body<const FUSED: bool>(
        &mut self,
        z: &[f64],
        e: &[f64],
        rows: &mut [f64],
        signals: &mut [Vector],
    ) {
        match self.shape.order {
            2 => self.samples::<FUSED, _>([ZEROS; 2], z, e, rows, signals),
            3 => self.samples::<FUSED, _>([ZEROS; 3], z, e, rows, signals),
            4 => self.samples::<FUSED, _>([ZEROS; 4], z, e, rows, signals),
            5 => self.samples::<FUSED, _>([ZEROS; 5], z, e, rows, signals),
            6 => self.samples::<FUSED, _>([ZEROS; 6], z, e, rows, signals),
            n => self.samples::<FUSED, _>(vec![ZEROS; n], z, e, rows, signals),
        }
    }

    /// `states` and its copy are storage for the states in a vector.
    #[inline(always)]
    fn samples<const FUSED: bool, S: AsMut<[Vector]> + Clone>(
        &mut self,
        mut states: S,
        z: &[f64],
        e: &[f64],
        rows: &mut [f64],
        signals: &mut [Vector],
    ) {
        let (p, width) = (self.shape.outputs, self.shape.inputs + self.shape.outputs);
        let mut next = states.clone();
        let (states, next) = (states.as_mut(), next.as_mut());
        let n = states.len();
        // The unused lanes of a state are zero. They end in the columns of the next state or of the
        // inputs, which are written afterwards: the last vector comes first.
        for vector in (0..self.vectors).rev() {
            for lane in 0..LANES {
                let j = (vector * LANES + lane) % (self.driven + 1);
                if j < self.driven {
                    let inputs = z[j..].iter().step_by(width);
                    signals
                        .iter_mut()
                        .zip(inputs)
                        .for_each(|(s, u)| s[lane] = *u);
                }
            }
            let drive = &self.drive[vector * n..][..n];
            let stored = &mut self.states[vector * n..][..n];
            states.copy_from_slice(stored);
            let samples = rows.chunks_exact_mut(self.stride).take(e.len() / p);
            for (row, signal) in samples.zip(signals.iter()) {
                for i in 0..n {
                    let target = &mut row[vector * LANES + i * self.filters..][..LANES];
                    target.copy_from_slice(&states[i]);
                }
                for i in 0..n {
                    let mut sum = ZEROS;
                    for b in 0..LANES {
                        sum[b] = drive[i][b] * signal[b];
                    }
                    for l in 0..n {
                        let weight = self.closed[l * n + i];
                        for b in 0..LANES {
                            sum[b] = multiply_add::<FUSED>(weight, states[l][b], sum[b]);
                        }
                    }
                    next[i] = sum;
                }
                states.copy_from_slice(next);
            }
            stored.copy_from_slice(states);
        }
        let first_input = n * self.filters;
        let first_error = first_input + self.direct.len();
        for (index, &j) in self.direct.iter().enumerate() {
            let targets = rows[first_input + index..].iter_mut().step_by(self.stride);
            let inputs = z[j..].iter().step_by(width);
            targets.zip(inputs).for_each(|(row, u)| *row = *u);
        }
        for o in 0..p {
            let targets = rows[first_error + o..].iter_mut().step_by(self.stride);
            for (row, e) in targets.zip(e.chunks_exact(p)) {
                *row = dot(&self.whitening[o * p..][..o + 1], e);
            }
        }
    }
}

const ZEROS: Vector = [0.0; LANES];

/// Largest absolute value.
fn largest(vectors: &[Vector]) -> f64 {
    let values = vectors.as_flattened().iter();
    values.fold(0.0, |largest, x| largest.max(x.abs()))
}

#[inline(always)]
fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

fn identity(size: usize) -> Vec<f64> {
    (0..size * size)
        .map(|entry| f64::from(u8::from(entry / size == entry % size)))
        .collect()
}

/// Inverse of a lower triangular matrix.
fn inverse_lower(factor: &[f64], size: usize) -> Vec<f64> {
    let mut result = vec![0.0; size * size];
    for j in 0..size {
        let mut column = vec![0.0; size];
        column[j] = 1.0;
        solve_lower(factor, size, &mut column);
        (0..size).for_each(|i| result[i * size + j] = column[i]);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;
    use crate::sensitivity;

    /// The last shapes have more filters than lanes.
    const SHAPES: [[usize; 3]; 6] = [
        [3, 2, 2],
        [2, 1, 3],
        [7, 3, 1],
        [1, 1, 1],
        [4, 2, 3],
        [2, 4, 4],
    ];
    const LENGTHS: [usize; 2] = [170, 95];

    /// Pseudo-random number between -1/2 and 1/2.
    fn number(k: usize) -> f64 {
        let mixed = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / 16_777_216.0
            - 0.5
    }

    fn samples(shape: Shape) -> Vec<f64> {
        let count = LENGTHS.iter().sum::<usize>() * (shape.inputs + shape.outputs);
        (0..count).map(|k| number(1000 + k)).collect()
    }

    fn model([order, inputs, outputs]: [usize; 3]) -> Model {
        let shape = Shape {
            order,
            inputs,
            outputs,
        };
        let size = shape.initial_state(LENGTHS.len()).start;
        let values = (0..size).map(|k| 1.5 / (order as f64).sqrt() * number(k));
        Model {
            shape,
            values: values.collect(),
        }
    }

    /// The gradient of the weighted sum of squares with respect to the estimated entries is zero.
    #[test]
    fn estimate_is_a_stationary_point() {
        for shape in SHAPES {
            let start = model(shape);
            let [n, m, p] = shape;
            let samples = samples(start.shape);
            let records = split(start.shape, &samples, &LENGTHS);
            let flags: Vec<bool> = (0..m).map(|j| j % 2 == 0).collect();
            for entries in [
                Entries::Plant(&flags),
                Entries::Plant(&vec![false; m]),
                Entries::InitialStates,
            ] {
                for weighted in [None, Some(1e-20)] {
                    let mut solution = start.clone();
                    assert!(estimate(&mut solution, &records, entries, None));
                    let mut whitener = identity(p);
                    if weighted.is_some() {
                        let e = predictor::innovations(&solution, &records);
                        whitener = cholesky(&predictor::covariance(&e, p), p).unwrap();
                        assert!(estimate(&mut solution, &records, entries, weighted));
                    }
                    let gradient =
                        sensitivity::normal_equations(&solution, &records, &whitener).gradient;
                    for index in Problem::new(&start, 2, entries).indices {
                        // rounding of sums of 265 products of about one
                        assert!(
                            gradient[index].abs() < 1e-9,
                            "{n} {m} {p}: {}",
                            gradient[index]
                        );
                    }
                }
            }
        }
    }

    /// Equal outputs have a singular covariance, so the second solution needs whitened sums.
    #[test]
    fn dependent_innovations_have_a_solution() {
        let mut start = model([2, 1, 2]);
        let shape = start.shape;
        start
            .values
            .copy_within(shape.c().start..shape.c().start + 2, shape.c().start + 2);
        let mut samples = samples(shape);
        samples.chunks_exact_mut(3).for_each(|z| z[2] = z[1]);
        let records = split(shape, &samples, &LENGTHS);
        let entries = Entries::Plant(&[true]);
        let mut first = start.clone();
        assert!(estimate(&mut first, &records, entries, None));
        let mut second = start;
        assert!(estimate(&mut second, &records, entries, Some(1e-20)));
        for (l, r) in first.values.iter().zip(&second.values) {
            assert!((l - r).abs() < 1e-6, "{l} {r}");
        }
    }

    #[test]
    fn overflowing_predictor_has_no_estimate() {
        let mut unstable = model([2, 1, 1]);
        unstable.values[unstable.shape.a()].copy_from_slice(&[40.0, 0.0, 0.0, 40.0]);
        let samples = samples(unstable.shape);
        let records = split(unstable.shape, &samples, &LENGTHS);
        assert!(!estimate(
            &mut unstable,
            &records,
            Entries::Plant(&[true]),
            None
        ));
    }

    /// Rows without derivatives do not change an estimate of initial states: the gradient is zero.
    #[test]
    fn decayed_initial_states_end_the_sums() {
        let mut start = model([3, 2, 2]);
        start.values[start.shape.a()]
            .iter_mut()
            .for_each(|entry| *entry *= 0.3);
        start.values[start.shape.k()].fill(0.0);
        let samples = samples(start.shape);
        let records = split(start.shape, &samples, &LENGTHS);
        let problem = Problem::new(&start, 2, Entries::InitialStates);
        assert!(
            problem
                .sums(&start, &records, &identity(2))
                .samples
                .is_none()
        );
        for weighted in [None, Some(1e-20)] {
            assert!(estimate(
                &mut start,
                &records,
                Entries::InitialStates,
                weighted
            ));
        }
        let e = predictor::innovations(&start, &records);
        let whitener = cholesky(&predictor::covariance(&e, 2), 2).unwrap();
        let gradient = sensitivity::normal_equations(&start, &records, &whitener).gradient;
        // the whitener of the second solution differs from that of the first by its effect on it
        assert!(
            gradient[start.shape.entries()..]
                .iter()
                .all(|g| g.abs() < 1e-2)
        );
    }
}
