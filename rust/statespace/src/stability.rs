//! Stability of a matrix, and a barrier at the boundary of stability.

use crate::linalg::inverse;
use crate::model::{Model, Shape};

/// Sums of long products that do not wait for one another.
const SUMS: usize = 8;
/// Largest number of squarings: 2^40 steps are longer than any record.
const MAX_DOUBLINGS: usize = 40;

/// Whether every eigenvalue of a square row-major matrix is inside the unit circle.
///
/// Squares A repeatedly: a Frobenius norm of A^(2^k) below one proves that the spectral radius is
/// below one. No eigenvalues are computed, so clustered eigenvalues, as of a finely sampled arm,
/// lose no accuracy. Eigenvalues within 1e-12 of the circle count as outside.
pub fn is_stable(matrix: &[f64], order: usize) -> bool {
    let mut power = matrix.to_vec();
    let mut square = vec![0.0; power.len()];
    for _ in 0..MAX_DOUBLINGS {
        let norm = power.iter().map(|entry| entry * entry).sum::<f64>();
        if norm < 1.0 {
            return true;
        }
        if !norm.is_finite() {
            return false;
        }
        for i in 0..order {
            for j in 0..order {
                square[i * order + j] = (0..order)
                    .map(|k| power[i * order + k] * power[k * order + j])
                    .sum();
            }
        }
        std::mem::swap(&mut power, &mut square);
    }
    false
}

/// -(1/2) log det(I - F (x) F) of a matrix F, with its first two derivatives with respect to the
/// entries of F, which is A - K C, and A as well if the model must be stable.
///
/// In terms of eigenvalues this is -(1/2) sum log(1 - l_i l_j): smooth, invariant to coordinates,
/// and infinite at the unit circle. A likelihood with fitted initial states lacks the loss of
/// information of a predictor that forgets slowly; for one state the exact likelihood contains this
/// term. Without it, the best predictor of a short record is often unstable. Relative to a
/// likelihood that grows with the length of the record it is negligible.
pub struct Barrier {
    /// Value of the barrier.
    pub value: f64,
    slope: Vec<f64>,
    /// (n^2, n^2), tr(P_a P_b) / 2 with P the inverse times the change by an entry of F.
    curvature: Vec<f64>,
}

impl Barrier {
    /// Barrier of F, (n, n) row-major; `None` if F is unstable.
    pub fn at(f: &[f64], n: usize) -> Option<Self> {
        if !is_stable(f, n) {
            return None;
        }
        let size = n * n;
        let mut difference = vec![0.0; size * size];
        for (row, column) in pairs(size) {
            let ((i, k), (j, l)) = ((row / n, row % n), (column / n, column % n));
            let one = f64::from(u8::from(row == column));
            difference[row * size + column] = one - f[i * n + j] * f[k * n + l];
        }
        let (inverse, log_determinant) = inverse(difference, size)?;
        // M^-1 dM for each entry of F, dM = -(E (x) F + F (x) E).
        let relative: Vec<Vec<f64>> = pairs(n)
            .map(|e| relative_change(&inverse, f, n, e))
            .collect();
        let trace = |p: &[f64]| (0..size).map(|i| p[i * size + i]).sum::<f64>();
        let slope = relative.iter().map(|p| -0.5 * trace(p)).collect();
        let mut curvature = vec![0.0; size * size];
        for (b, of_b) in relative.iter().enumerate() {
            let transposed: Vec<f64> = pairs(size).map(|(i, j)| of_b[j * size + i]).collect();
            for a in 0..=b {
                let product = 0.5 * dot(&relative[a], &transposed); // half the trace of a product
                curvature[a * size + b] = product;
                curvature[b * size + a] = product;
            }
        }
        Some(Self {
            value: -0.5 * log_determinant,
            slope,
            curvature,
        })
    }

    /// Gradient and curvature along `directions`, which are changes of F: (n^2,) row-major each.
    ///
    /// The curvature omits terms of lower order near the unit circle, and may be indefinite. With
    /// `definite`, twice the square of the slope replaces it, which is exact to that order for a
    /// single eigenvalue.
    pub fn along(&self, directions: &[Vec<f64>], definite: bool) -> (Vec<f64>, Vec<f64>) {
        let size = self.slope.len();
        let gradient: Vec<f64> = directions.iter().map(|d| dot(&self.slope, d)).collect();
        let width = directions.len();
        let mut curvature = vec![0.0; width * width];
        for (i, left) in directions.iter().enumerate() {
            let product: Vec<f64> = self
                .curvature
                .chunks_exact(size)
                .map(|row| dot(row, left))
                .collect();
            for (j, right) in directions.iter().enumerate() {
                curvature[i * width + j] = if definite {
                    2.0 * gradient[i] * gradient[j]
                } else {
                    dot(&product, right)
                };
            }
        }
        (gradient, curvature)
    }
}

/// Change of F = A - K C for a `change` of the model's vector.
pub fn predictor_change(model: &Model, change: &[f64]) -> Vec<f64> {
    let Shape {
        order: n,
        outputs: p,
        ..
    } = model.shape;
    let (c, k) = (model.c(), model.k());
    let (dc, dk) = (&change[model.shape.c()], &change[model.shape.k()]);
    let mut moved = change[model.shape.a()].to_vec();
    for (i, j) in pairs(n) {
        for o in 0..p {
            moved[i * n + j] -= dk[i * p + o] * c[o * n + j] + k[i * p + o] * dc[o * n + j];
        }
    }
    moved
}

/// -inverse (E (x) F + F (x) E) with E one at entry (i, j).
fn relative_change(inverse: &[f64], f: &[f64], n: usize, (i, j): (usize, usize)) -> Vec<f64> {
    let size = n * n;
    let mut product = vec![0.0; size * size];
    for row in 0..size {
        for (k, l) in pairs(n) {
            let weight = f[k * n + l];
            product[row * size + j * n + l] -= inverse[row * size + i * n + k] * weight;
            product[row * size + l * n + j] -= inverse[row * size + k * n + i] * weight;
        }
    }
    product
}

/// Sum of products of long lists.
fn dot(left: &[f64], right: &[f64]) -> f64 {
    let (left, left_end) = left.as_chunks::<SUMS>();
    let (right, right_end) = right.as_chunks::<SUMS>();
    let mut sums = [0.0; SUMS];
    for (left, right) in left.iter().zip(right) {
        for k in 0..SUMS {
            sums[k] += left[k] * right[k];
        }
    }
    let end: f64 = left_end.iter().zip(right_end).map(|(l, r)| l * r).sum();
    sums.iter().sum::<f64>() + end
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n * n).map(move |index| (index / n, index % n))
}

#[cfg(test)]
mod tests;
