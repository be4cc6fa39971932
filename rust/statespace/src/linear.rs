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
use crate::predictor::{self, DIVERGENCE_RATIO, Predictor};
use filters::{Filters, WIDTH_STEP};
use strainwave_numerics::products::{Part, Rows, add_products};
use strainwave_numerics::singular;

mod filters;

/// The left factors of the products are padded to a multiple, so that all tiles are whole.
const HEIGHT_STEP: usize = 4;

/// Smallest singular value of the scaled normal equations, relative to the largest.
const RANK_TOLERANCE: f64 = 1e-14;

/// Smallest share of the innovations in the terms that they are the sum of, for which their
/// covariance follows from the sums: its relative error is then about 1e-16 / 1e-8.
const MIN_SQUARE_SHARE: f64 = 1e-8;

/// Smallest determinant of the correlations of the innovations for which sums of unweighted outputs
/// are weighted afterwards; the weighting multiplies rounding by the reciprocal.
const MIN_CORRELATION_DETERMINANT: f64 = 1e-4;

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
mod tests;
