//! Local coordinates of a model without its similarity transformations.
//!
//! The transformation A -> T A T^-1, B -> T B, C -> C T^-1, K -> T K, x0 -> T x0 does not change
//! the innovations. At T = I + X the entries change along A -> X A - A X and so on: n^2 directions
//! that the data cannot determine. Their orthogonal complement is a minimal parametrisation around
//! the current model ("data-driven local coordinates", McKelvey, Helmersson and Ribarits,
//! Automatica 40, 2004). It is as well conditioned as the data allow, without the singularities of
//! canonical forms. Entries are scaled by their standard deviations before the complement is
//! formed, so that no step moves an entry further than the change of the model requires.

use crate::linalg::orthogonal_complement;
use crate::model::{Model, Shape};

/// Local coordinates over the free entries, orthonormal in the units of the entries.
#[derive(Clone)]
pub struct Coordinates {
    /// Indices of the free entries in the model's vector.
    free: Vec<usize>,
    /// (free, width), row-major.
    basis: Vec<f64>,
    /// Number of entries.
    size: usize,
    /// Number of coordinates.
    pub width: usize,
}

impl Coordinates {
    /// Coordinates around a model, for the entries listed in `free`; `unit` is the scale of each
    /// entry of the model.
    pub fn at(model: &Model, free: &[usize], unit: &[f64]) -> Self {
        let n = model.shape.order;
        let directions = n * n;
        let all = similarity_directions(model);
        let matrix: Vec<f64> = free
            .iter()
            .flat_map(|&entry| {
                let row = &all[entry * directions..][..directions];
                row.iter().map(move |moved| moved / unit[entry])
            })
            .collect();
        let (size, width) = (model.values.len(), free.len() - directions);
        let mut basis = orthogonal_complement(matrix, free.len(), directions);
        for (row, &entry) in basis.chunks_exact_mut(width).zip(free) {
            row.iter_mut().for_each(|moved| *moved *= unit[entry]);
        }
        Self {
            free: free.to_vec(),
            basis,
            size,
            width,
        }
    }

    /// Q' g.
    pub fn reduce_gradient(&self, gradient: &[f64]) -> Vec<f64> {
        let mut reduced = vec![0.0; self.width];
        for (row, &entry) in self.basis.chunks_exact(self.width).zip(&self.free) {
            add_scaled(&mut reduced, gradient[entry], row);
        }
        reduced
    }

    /// Q' H Q.
    pub fn reduce_hessian(&self, hessian: &[f64]) -> Vec<f64> {
        let (size, width) = (self.size, self.width);
        let mut reduced = vec![0.0; width * width];
        let mut product = vec![0.0; width];
        for (left, &i) in self.basis.chunks_exact(width).zip(&self.free) {
            product.fill(0.0);
            for (right, &j) in self.basis.chunks_exact(width).zip(&self.free) {
                add_scaled(&mut product, hessian[i * size + j], right);
            }
            for (row, &weight) in reduced.chunks_exact_mut(width).zip(left) {
                add_scaled(row, weight, &product);
            }
        }
        reduced
    }

    /// Change of the model's vector per unit of coordinate `index`.
    pub fn direction(&self, index: usize) -> Vec<f64> {
        let mut change = vec![0.0; self.size];
        for (row, &entry) in self.basis.chunks_exact(self.width).zip(&self.free) {
            change[entry] = row[index];
        }
        change
    }

    /// Adds Q step to the model's vector.
    pub fn advance(&self, values: &mut [f64], step: &[f64]) {
        for (row, &entry) in self.basis.chunks_exact(self.width).zip(&self.free) {
            values[entry] += row.iter().zip(step).map(|(q, s)| q * s).sum::<f64>();
        }
    }

    /// Q M Q' for a (width, width) matrix M, over all entries; fixed entries get zeros.
    pub fn expand(&self, matrix: &[f64]) -> Vec<f64> {
        let (size, width) = (self.size, self.width);
        let mut expanded = vec![0.0; size * size];
        let mut product = vec![0.0; width];
        for (left, &i) in self.basis.chunks_exact(width).zip(&self.free) {
            product.fill(0.0);
            for (row, &weight) in matrix.chunks_exact(width).zip(left) {
                add_scaled(&mut product, weight, row);
            }
            for (right, &j) in self.basis.chunks_exact(width).zip(&self.free) {
                expanded[i * size + j] = product.iter().zip(right).map(|(l, r)| l * r).sum();
            }
        }
        expanded
    }
}

fn add_scaled(target: &mut [f64], weight: f64, source: &[f64]) {
    target
        .iter_mut()
        .zip(source)
        .for_each(|(t, s)| *t += weight * s);
}

/// Change of every entry for X = e_r e_s': (entries, n^2).
fn similarity_directions(model: &Model) -> Vec<f64> {
    let Shape {
        order: n,
        inputs: m,
        outputs: p,
    } = model.shape;
    let columns = n * n;
    let mut directions = vec![0.0; model.values.len() * columns];
    let mut left = |start: usize, width: usize| {
        // X M: row r is row s of M
        for r in 0..n {
            for s in 0..n {
                for j in 0..width {
                    directions[(start + r * width + j) * columns + r * n + s] +=
                        model.values[start + s * width + j];
                }
            }
        }
    };
    left(model.shape.a().start, n);
    left(model.shape.b().start, m);
    left(model.shape.k().start, p);
    let records = (model.values.len() - model.shape.entries()) / n;
    for index in 0..records {
        left(model.shape.initial_state(index).start, 1);
    }
    let mut right = |start: usize, height: usize| {
        // -M X: column s is minus column r of M
        for r in 0..n {
            for s in 0..n {
                for i in 0..height {
                    directions[(start + i * n + s) * columns + r * n + s] -=
                        model.values[start + i * n + r];
                }
            }
        }
    };
    right(model.shape.a().start, n);
    right(model.shape.c().start, p);
    directions
}
