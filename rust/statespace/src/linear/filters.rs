//! Filters of one record in vectors, and the rows of their states, inputs and innovations.

use super::{Problem, dot};
use crate::model::{Model, Record, Shape};
use crate::predictor::{BLOCK, Predictor};
use strainwave_numerics::products::{BASELINE_IS_FUSED, multiply_add};

/// Lanes of a vector with AVX-512; the states of all filters of an output side by side.
const LANES: usize = 8;

/// Columns of a row of products are a multiple, so that no product falls to a narrow tile.
pub(super) const WIDTH_STEP: usize = 12;

/// Contribution of an initial state, relative to its start, below which it is zero: far below
/// rounding of the innovations.
const MIN_RELATIVE_STATE: f64 = 1e-20;

/// Size of a filter state below which it is zero: its square is still a normal number, and far below
/// the rounding of any sum.
const MIN_STATE: f64 = 1e-150;

/// The filters of one record.
pub(super) struct Filters {
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
    pub(super) fn new(problem: &Problem, model: &Model, whitening: &[f64]) -> Self {
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
    pub(super) fn run(
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
