//! Small dense linear algebra: products, Cholesky, triangular solves, an orthogonal complement.
//!
//! Sizes are numbers of parameters (tens), so a dependency is not justified.

/// Lower Cholesky factor of a symmetric row-major matrix; `None` if it is not positive definite.
///
/// A pivot below the rounding of its diagonal entry counts as not positive.
pub fn cholesky(matrix: &[f64], size: usize) -> Option<Vec<f64>> {
    let mut factor = vec![0.0; size * size];
    for i in 0..size {
        for j in 0..=i {
            let known: f64 = (0..j)
                .map(|k| factor[i * size + k] * factor[j * size + k])
                .sum();
            let rest = matrix[i * size + j] - known;
            if i == j {
                let negligible = size as f64 * f64::EPSILON * matrix[i * size + i];
                if !rest.is_finite() || rest <= negligible {
                    return None;
                }
                factor[i * size + i] = rest.sqrt();
            } else {
                factor[i * size + j] = rest / factor[j * size + j];
            }
        }
    }
    Some(factor)
}

/// Solves L z = b in place.
pub fn solve_lower(factor: &[f64], size: usize, rhs: &mut [f64]) {
    for i in 0..size {
        let known: f64 = (0..i).map(|k| factor[i * size + k] * rhs[k]).sum();
        rhs[i] = (rhs[i] - known) / factor[i * size + i];
    }
}

/// Solves L' z = b in place.
pub fn solve_lower_transposed(factor: &[f64], size: usize, rhs: &mut [f64]) {
    for i in (0..size).rev() {
        let known: f64 = (i + 1..size).map(|k| factor[k * size + i] * rhs[k]).sum();
        rhs[i] = (rhs[i] - known) / factor[i * size + i];
    }
}

/// log det of a matrix, from its lower Cholesky factor.
pub fn log_determinant(factor: &[f64], size: usize) -> f64 {
    2.0 * (0..size).map(|i| factor[i * size + i].ln()).sum::<f64>()
}

/// Inverse of a square matrix and log of its determinant, by Gauss-Jordan elimination with row
/// exchanges.
///
/// Returns `None` if the matrix is singular or its determinant is not positive.
pub fn inverse(mut matrix: Vec<f64>, size: usize) -> Option<(Vec<f64>, f64)> {
    let mut result = vec![0.0; size * size];
    for i in 0..size {
        result[i * size + i] = 1.0;
    }
    let (mut log_determinant, mut positive) = (0.0, true);
    for j in 0..size {
        let largest = |a: &usize, b: &usize| {
            matrix[a * size + j]
                .abs()
                .total_cmp(&matrix[b * size + j].abs())
        };
        let from = (j..size).max_by(largest)?;
        let pivot = matrix[from * size + j];
        if !pivot.is_normal() {
            return None;
        }
        log_determinant += pivot.abs().ln();
        positive ^= (from != j) ^ (pivot < 0.0);
        for side in [&mut matrix, &mut result] {
            for column in 0..size {
                side.swap(from * size + column, j * size + column);
                side[j * size + column] /= pivot;
            }
        }
        for i in (0..size).filter(|&i| i != j) {
            let weight = matrix[i * size + j];
            for side in [&mut matrix, &mut result] {
                for column in 0..size {
                    side[i * size + column] -= weight * side[j * size + column];
                }
            }
        }
    }
    positive.then_some((result, log_determinant))
}

/// Orthonormal basis of the orthogonal complement of the columns of a (rows, columns) matrix.
///
/// By Householder reflections. Returns (rows, rows - columns), row-major.
pub fn orthogonal_complement(mut matrix: Vec<f64>, rows: usize, columns: usize) -> Vec<f64> {
    let mut reflections = Vec::with_capacity(columns);
    for j in 0..columns {
        let mut v: Vec<f64> = (j..rows).map(|i| matrix[i * columns + j]).collect();
        let norm = v.iter().map(|entry| entry * entry).sum::<f64>().sqrt();
        v[0] += if v[0] < 0.0 { -norm } else { norm };
        let square: f64 = v.iter().map(|entry| entry * entry).sum();
        if square > 0.0 {
            let scale = square.sqrt().recip();
            v.iter_mut().for_each(|entry| *entry *= scale);
        }
        reflect(&v, &mut matrix, j, columns);
        reflections.push(v);
    }
    let width = rows - columns;
    let mut basis = vec![0.0; rows * width];
    for j in 0..width {
        basis[(columns + j) * width + j] = 1.0;
    }
    for (j, v) in reflections.iter().enumerate().rev() {
        reflect(v, &mut basis, j, width);
    }
    basis
}

/// Applies I - 2 v v' to the rows from `start`.
fn reflect(v: &[f64], matrix: &mut [f64], start: usize, columns: usize) {
    let mut sums = vec![0.0; columns];
    for (i, weight) in v.iter().enumerate() {
        let row = &matrix[(start + i) * columns..][..columns];
        sums.iter_mut()
            .zip(row)
            .for_each(|(sum, entry)| *sum += weight * entry);
    }
    for (i, weight) in v.iter().enumerate() {
        let row = &mut matrix[(start + i) * columns..][..columns];
        row.iter_mut()
            .zip(&sums)
            .for_each(|(entry, sum)| *entry -= 2.0 * weight * sum);
    }
}

/// Product of a matrix of `rows` rows with another matrix.
pub fn product(left: &[f64], right: &[f64], rows: usize) -> Vec<f64> {
    let inner = left.len() / rows;
    let columns = right.len() / inner;
    let mut result = vec![0.0; rows * columns];
    for (i, target) in result.chunks_exact_mut(columns).enumerate() {
        for (weight, row) in left[i * inner..][..inner]
            .iter()
            .zip(right.chunks_exact(columns))
        {
            target
                .iter_mut()
                .zip(row)
                .for_each(|(sum, entry)| *sum += weight * entry);
        }
    }
    result
}

/// Transpose of a matrix of `rows` rows.
pub fn transposed(matrix: &[f64], rows: usize) -> Vec<f64> {
    let columns = matrix.len() / rows;
    (0..columns * rows)
        .map(|index| matrix[index % rows * columns + index / rows])
        .collect()
}

#[cfg(test)]
mod tests;
