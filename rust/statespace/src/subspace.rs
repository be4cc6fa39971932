//! Subspace methods: A, C and the states of a model from triangular factors of the data.
//!
//! All methods use the factor R of [u[k], z[k-1], ..., z[k-past], y[k]] with samples z = [u, y], for
//! the regression on the states. It has one sample more than the past, so the next state also has a
//! full past.

use crate::hankel::{Hankel, is_well_conditioned};
use crate::linalg::{product, transposed};
use crate::model::{Model, Record, Shape};
use std::sync::OnceLock;
use strainwave_numerics::products::{Part, Rows, add_products};
use strainwave_numerics::{singular, triangular};

mod regression;

/// Smallest singular value relative to the largest for the selection of an order.
const MIN_RELATIVE_VALUE: f64 = 1e-14;

/// Smallest singular value of regressors relative to the largest; smaller ones are rounding.
const RANK_TOLERANCE: f64 = 1e-12;

/// How the states are estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// A and C from the column space of the past-output MOESP method, states from the oblique
    /// projection.
    Moesp,
    /// States from the singular vectors of the oblique projection.
    N4sid,
    /// States from a high-order ARX model.
    Predictor,
}

/// Order and structure of a model.
#[derive(Clone, Copy, Debug)]
pub struct Options<'a> {
    /// Number of states; `None`: that with the largest ratio of successive singular values.
    pub order: Option<usize>,
    /// Highest order that the singular values can select.
    pub max_order: usize,
    /// For each input, whether it acts on the outputs without delay.
    pub feedthrough: &'a [bool],
    /// Variance added to the residuals of every output, at the level of rounding.
    pub floor: f64,
}

impl Options<'_> {
    fn order(&self, singular_values: &[f64]) -> usize {
        self.order
            .unwrap_or_else(|| largest_gap(singular_values, self.max_order))
    }
}

/// Triangular factors of one data set for one horizon.
pub struct Subspace {
    shape: Shape,
    past: usize,
    /// R and the number of rows of the data.
    regression: OnceLock<(Vec<f64>, usize)>,
    predictor: OnceLock<Predictor>,
}

/// Coefficients of an ARX model, and the singular directions of its states.
struct Predictor {
    /// [M_1, M_2, ...]: (p, past width).
    coefficients: Vec<f64>,
    /// Singular values and vectors of what the past contributes to future outputs.
    directions: singular::Decomposition,
}

/// States as multiples of the past, newest sample first.
struct States {
    /// (n, past width)
    of_past: Vec<f64>,
    order: usize,
    singular_values: Vec<f64>,
    /// A and C; `None`: by regression on the states.
    given: Option<(Vec<f64>, Vec<f64>)>,
}

impl Subspace {
    /// `shape` has any order; `past` samples before and after a sample make its row.
    pub fn new(shape: Shape, past: usize) -> Self {
        Self {
            shape,
            past,
            regression: OnceLock::new(),
            predictor: OnceLock::new(),
        }
    }

    fn width(&self) -> usize {
        self.shape.inputs + self.shape.outputs
    }

    /// Columns of R before y[k].
    fn lead(&self) -> usize {
        self.shape.inputs + self.past * self.width()
    }

    /// R, (size, size) with size = (past + 1) width, and the number of rows of the data.
    pub fn regression(&self, records: &[Record<'_>]) -> &(Vec<f64>, usize) {
        self.regression.get_or_init(|| {
            let hankel = Hankel::new(self.shape, records, self.past + 1);
            self.regression_of(&hankel)
        })
    }

    fn regression_of(&self, hankel: &Hankel<'_>) -> (Vec<f64>, usize) {
        let (m, width, now) = (self.shape.inputs, self.width(), self.past * self.width());
        let lags = (0..self.past)
            .rev()
            .flat_map(|k| k * width..(k + 1) * width);
        let order = (now..now + m).chain(lags).chain(now + m..now + width);
        let order: Vec<usize> = order.collect();
        hankel.factor(self.past + 1, &order, now + width)
    }

    /// Rows of the factor of [future inputs, past z, future outputs] up to the past.
    fn past_and_future(&self, records: &[Record<'_>]) -> Vec<f64> {
        let (m, width, past) = (self.shape.inputs, self.width(), self.past);
        let hankel = Hankel::new(self.shape, records, 2 * past);
        self.regression.get_or_init(|| self.regression_of(&hankel));
        let future = |channels: std::ops::Range<usize>| {
            (past..2 * past).flat_map(move |k| channels.clone().map(move |c| k * width + c))
        };
        let order = future(0..m).chain(0..past * width).chain(future(m..width));
        let order: Vec<usize> = order.collect();
        hankel.factor(2 * past, &order, past * (m + width)).0
    }

    /// Balanced model with zero initial states, and the singular values.
    pub fn realise(
        &self,
        records: &[Record<'_>],
        method: Method,
        options: &Options<'_>,
    ) -> (Model, Vec<f64>) {
        let states = match method {
            Method::Moesp => self.moesp(records, options),
            Method::N4sid => self.n4sid(records, options),
            Method::Predictor => self.predictor(records, options),
        };
        let model = self.regress(records, &states, options);
        (model, states.singular_values)
    }

    /// Future outputs on the past, with the future inputs projected out.
    fn moesp(&self, records: &[Record<'_>], options: &Options<'_>) -> States {
        let (p, past) = (self.shape.outputs, self.past);
        let (size, history) = (2 * past * self.width(), past * self.width());
        let start = past * self.shape.inputs;
        let factor = self.past_and_future(records);
        let onto_past = block(&factor, size, start..start + history, start + history..size);
        let decomposition = decompose_tall(&onto_past, past * p);
        let n = options.order(&decomposition.values);
        let observability = observability(&decomposition, n);
        let (above, below) = (
            &observability[..(past - 1) * p * n],
            &observability[p * n..],
        );
        let a = least_squares(above, below, n, f64::EPSILON * (past * p) as f64);
        let c = observability[..p * n].to_vec();
        // x = O^+ (oblique projection) = O^+ L_wy' L_ww'^-1 w
        let right = product(&onto_past, &pseudo_inverse(&decomposition, n), history);
        let square = block(
            &factor,
            size,
            start..start + history,
            start..start + history,
        );
        let oblique = solve_upper(&square, history, &right);
        States {
            of_past: self.newest_first(&oblique, n),
            order: n,
            singular_values: decomposition.values,
            given: Some((a, c)),
        }
    }

    /// States from the unweighted oblique projection.
    fn n4sid(&self, records: &[Record<'_>], options: &Options<'_>) -> States {
        let (p, past) = (self.shape.outputs, self.past);
        let (size, history) = (2 * past * self.width(), past * self.width());
        let start = past * self.shape.inputs;
        let stop = start + history;
        let factor = self.past_and_future(records);
        let square = block(&factor, size, start..stop, start..stop);
        let right = block(&factor, size, start..stop, stop..size);
        let onto_past = solve_upper(&square, history, &right);
        // the projection acts on w itself, not on w after removal of the future inputs
        let projection = product(
            &block(&factor, size, 0..stop, start..stop),
            &onto_past,
            stop,
        );
        let decomposition = decompose_tall(&projection, past * p);
        let n = options.order(&decomposition.values);
        let oblique = product(&onto_past, &pseudo_inverse(&decomposition, n), history);
        States {
            of_past: self.newest_first(&oblique, n),
            order: n,
            singular_values: decomposition.values,
            given: None,
        }
    }

    /// States from the ARX model y[k] = D u[k] + sum M_i z[k-i] + e[k].
    ///
    /// M_i = C (A - K C)^(i-1) [B - K D, K]. C (A - K C)^j times the state is the sum of M_(i+j)
    /// z[k-i]. Terms beyond the past are neglected.
    fn predictor(&self, records: &[Record<'_>], options: &Options<'_>) -> States {
        let (p, width, history) = (self.shape.outputs, self.width(), self.past * self.width());
        let predictor = self.predictor.get_or_init(|| self.directions(records));
        let Predictor {
            coefficients,
            directions,
        } = predictor;
        let n = options.order(&directions.values);
        let mut of_past = vec![0.0; n * history];
        for (k, state) in of_past.chunks_exact_mut(history).enumerate() {
            let scale = directions.values[k].sqrt().recip();
            let direction = &directions.right[k * self.past * p..][..self.past * p];
            for (index, entry) in direction.iter().enumerate() {
                let shift = index / p * width;
                let row = &coefficients[index % p * history..][..history];
                add_scaled(&mut state[..history - shift], scale * entry, &row[shift..]);
            }
        }
        States {
            of_past,
            order: n,
            singular_values: directions.values.clone(),
            given: None,
        }
    }

    fn directions(&self, records: &[Record<'_>]) -> Predictor {
        let (m, p, past, width) = (
            self.shape.inputs,
            self.shape.outputs,
            self.past,
            self.width(),
        );
        let (lead, size, history) = (self.lead(), self.lead() + p, past * width);
        let (factor, _) = self.regression(records);
        let square = block(factor, size, 0..lead, 0..lead);
        let solution = solve_upper(&square, lead, &block(factor, size, 0..lead, lead..size));
        let coefficients = transposed(&solution[m * p..], history);
        // column (j, o): the coefficients of output o, shifted by j samples
        let mut shifted = vec![0.0; history * past * p];
        for (i, row) in shifted.chunks_exact_mut(past * p).enumerate() {
            for j in 0..past - i / width {
                for o in 0..p {
                    row[j * p + o] = coefficients[o * history + i + j * width];
                }
            }
        }
        let columns = transposed(&block(factor, size, 0..lead, m..lead), lead);
        let mut contribution = vec![0.0; lead * past * p];
        let rows = |data, width| Rows {
            data,
            stride: width,
            width,
        };
        let (left, right) = (rows(&columns[..], lead), rows(&shifted[..], past * p));
        add_products(&mut contribution, left, right, history, Part::Whole);
        Predictor {
            coefficients,
            directions: decompose_tall(&contribution, past * p),
        }
    }

    /// State coefficients (n, past width) from (past width, n) with the oldest sample first.
    fn newest_first(&self, oblique: &[f64], n: usize) -> Vec<f64> {
        let (past, width) = (self.past, self.width());
        let mut states = vec![0.0; n * past * width];
        for (i, row) in oblique.chunks_exact(n).enumerate() {
            let target = (past - 1 - i / width) * width + i % width;
            for (k, &entry) in row.iter().enumerate() {
                states[k * past * width + target] = entry;
            }
        }
        states
    }
}

/// Singular values and right singular vectors of a tall matrix.
fn decompose_tall(table: &[f64], columns: usize) -> singular::Decomposition {
    singular::decompose(&triangular::factor(table, columns), columns, &[])
}

/// V S^(1/2) of the leading singular values: (n_outputs past, n).
fn observability(decomposition: &singular::Decomposition, n: usize) -> Vec<f64> {
    scaled_vectors(decomposition, n, f64::sqrt)
}

/// Transpose of the pseudo-inverse V S^(-1/2) of `observability`.
fn pseudo_inverse(decomposition: &singular::Decomposition, n: usize) -> Vec<f64> {
    let negligible = f64::EPSILON.powi(2) * decomposition.values[0];
    scaled_vectors(decomposition, n, |value| {
        if value > negligible {
            value.sqrt().recip()
        } else {
            0.0
        }
    })
}

fn scaled_vectors(
    decomposition: &singular::Decomposition,
    n: usize,
    scale: impl Fn(f64) -> f64,
) -> Vec<f64> {
    let columns = decomposition.values.len();
    let mut vectors = vec![0.0; columns * n];
    for (k, row) in decomposition
        .right
        .chunks_exact(columns)
        .take(n)
        .enumerate()
    {
        let scale = scale(decomposition.values[k]);
        (0..columns).for_each(|i| vectors[i * n + k] = scale * row[i]);
    }
    vectors
}

/// Order after which the ratio of successive singular values is largest.
fn largest_gap(values: &[f64], max_order: usize) -> usize {
    let least = MIN_RELATIVE_VALUE * values[0];
    let values: Vec<f64> = values
        .iter()
        .take(max_order + 1)
        .map(|s| s.max(least))
        .collect();
    let ratios = values.windows(2).map(|pair| pair[0] / pair[1]);
    let (mut order, mut largest) = (1, 0.0);
    for (index, ratio) in ratios.enumerate() {
        if ratio > largest {
            (order, largest) = (index + 1, ratio);
        }
    }
    order
}

/// Least-norm solution X (columns, any) of left X = right.
fn least_squares(left: &[f64], right: &[f64], columns: usize, tolerance: f64) -> Vec<f64> {
    let rows = left.len() / columns;
    let sides = right.len() / rows;
    let mut table = Vec::with_capacity(left.len() + right.len());
    for (left, right) in left.chunks_exact(columns).zip(right.chunks_exact(sides)) {
        table.extend_from_slice(left);
        table.extend_from_slice(right);
    }
    let width = columns + sides;
    let factor = triangular::factor(&table, width);
    let square = block(&factor, width, 0..columns, 0..columns);
    let right = block(&factor, width, 0..columns, columns..width);
    singular::solve(&square, columns, &right, tolerance)
}

/// Solution of R x = right for triangular R; the least-norm solution if R is singular.
fn solve_upper(factor: &[f64], size: usize, right: &[f64]) -> Vec<f64> {
    if !is_well_conditioned(factor, size, size) {
        return singular::solve(factor, size, right, RANK_TOLERANCE);
    }
    let sides = right.len() / size;
    let mut solution = right.to_vec();
    for i in (0..size).rev() {
        let (row, below) = solution[i * sides..].split_at_mut(sides);
        for (weight, known) in factor[i * size + i + 1..]
            .iter()
            .zip(below.chunks_exact(sides))
        {
            add_scaled(row, -weight, known);
        }
        row.iter_mut()
            .for_each(|entry| *entry /= factor[i * size + i]);
    }
    solution
}

/// Part of a row-major matrix.
fn block(
    matrix: &[f64],
    columns: usize,
    rows: std::ops::Range<usize>,
    part: std::ops::Range<usize>,
) -> Vec<f64> {
    let rows = matrix[rows.start * columns..rows.end * columns].chunks_exact(columns);
    rows.flat_map(|row| row[part.clone()].iter().copied())
        .collect()
}

fn add_scaled(target: &mut [f64], weight: f64, source: &[f64]) {
    target
        .iter_mut()
        .zip(source)
        .for_each(|(t, s)| *t += weight * s);
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}
