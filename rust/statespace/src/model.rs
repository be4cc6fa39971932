//! Sizes and entries of a model, and records of data.

use std::ops::Range;

/// Sizes of a model, and the ranges of its matrices in the vector of all entries.
///
/// The order is A, B, C, D, K, each row-major. The initial states follow, one state per record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of states, n.
    pub order: usize,
    /// Number of inputs, m.
    pub inputs: usize,
    /// Number of outputs, p.
    pub outputs: usize,
}

impl Shape {
    /// Range of A.
    pub fn a(&self) -> Range<usize> {
        0..self.order * self.order
    }

    /// Range of B.
    pub fn b(&self) -> Range<usize> {
        let start = self.a().end;
        start..start + self.order * self.inputs
    }

    /// Range of C.
    pub fn c(&self) -> Range<usize> {
        let start = self.b().end;
        start..start + self.outputs * self.order
    }

    /// Range of D.
    pub fn d(&self) -> Range<usize> {
        let start = self.c().end;
        start..start + self.outputs * self.inputs
    }

    /// Range of K.
    pub fn k(&self) -> Range<usize> {
        let start = self.d().end;
        start..start + self.order * self.outputs
    }

    /// Number of entries of the five matrices.
    pub fn entries(&self) -> usize {
        self.k().end
    }

    /// Range of the initial state of record `index`.
    pub fn initial_state(&self, index: usize) -> Range<usize> {
        let start = self.entries() + index * self.order;
        start..start + self.order
    }
}

/// A model and the initial state of every record, as one vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Sizes.
    pub shape: Shape,
    /// A, B, C, D, K and initial states in the order of [`Shape`].
    pub values: Vec<f64>,
}

impl Model {
    /// State matrix.
    pub fn a(&self) -> &[f64] {
        &self.values[self.shape.a()]
    }

    /// Input matrix.
    pub fn b(&self) -> &[f64] {
        &self.values[self.shape.b()]
    }

    /// Output matrix.
    pub fn c(&self) -> &[f64] {
        &self.values[self.shape.c()]
    }

    /// Feedthrough.
    pub fn d(&self) -> &[f64] {
        &self.values[self.shape.d()]
    }

    /// Innovations gain.
    pub fn k(&self) -> &[f64] {
        &self.values[self.shape.k()]
    }

    /// State at the first sample of record `index`.
    pub fn initial_state(&self, index: usize) -> &[f64] {
        &self.values[self.shape.initial_state(index)]
    }

    /// A - K C, the state matrix of the predictor.
    pub fn predictor_matrix(&self) -> Vec<f64> {
        let Shape {
            order: n,
            outputs: p,
            ..
        } = self.shape;
        let (c, k) = (self.c(), self.k());
        let mut closed = self.a().to_vec();
        for i in 0..n {
            for j in 0..n {
                for o in 0..p {
                    closed[i * n + j] -= k[i * p + o] * c[o * n + j];
                }
            }
        }
        closed
    }
}

/// One uninterrupted record.
#[derive(Clone, Copy, Debug)]
pub struct Record<'a> {
    /// Inputs and outputs of every sample: (n_samples, m + p), row-major.
    pub samples: &'a [f64],
    /// Number of samples.
    pub len: usize,
}

/// Splits stacked samples [u, y] into records.
///
/// # Panics
/// The lengths do not add up to the number of rows.
pub fn split<'a>(shape: Shape, samples: &'a [f64], lengths: &[usize]) -> Vec<Record<'a>> {
    let width = shape.inputs + shape.outputs;
    let total: usize = lengths.iter().sum();
    assert_eq!(samples.len(), total * width, "rows of samples");
    let mut rest = samples;
    lengths
        .iter()
        .map(|&len| {
            let (samples, later) = rest.split_at(len * width);
            rest = later;
            Record { samples, len }
        })
        .collect()
}
