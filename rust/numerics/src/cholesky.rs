//! Cholesky factor of a symmetric matrix of a few hundred rows.

use crate::products::{multiply_add, with_vectors};

/// Rows of R that are subtracted from the remaining rows in one pass.
const PANEL: usize = 8;

/// Columns updated together; one vector with AVX-512.
const LANES: usize = 8;

/// Replaces the upper half of a row-major matrix by the first `pivots` rows of its factor R, with
/// R'R = matrix, and by the upper half of their Schur complement in the other rows.
///
/// Returns whether all pivots are positive. The lower half is not read; it becomes zero in the rows
/// of R. The decomposition ends at the first pivot that is not positive.
pub fn upper_factor(matrix: &mut [f64], size: usize, pivots: usize) -> bool {
    assert_eq!(matrix.len(), size * size);
    with_vectors!(panels(matrix: &mut [f64], size: usize, pivots: usize) -> bool)
}

#[inline(always)]
fn panels<const FUSED: bool>(matrix: &mut [f64], size: usize, pivots: usize) -> bool {
    for start in (0..pivots).step_by(PANEL) {
        let count = PANEL.min(pivots - start);
        let (done, rest) = matrix.split_at_mut((start + count) * size);
        let panel = &mut done[start * size..];
        for k in 0..count {
            let (above, row) = panel.split_at_mut(k * size);
            let row = &mut row[..size];
            row[..start + k].fill(0.0);
            for finished in above.chunks_exact(size) {
                let weight = -finished[start + k];
                for j in start + k..size {
                    row[j] = multiply_add::<FUSED>(weight, finished[j], row[j]);
                }
            }
            let pivot = row[start + k];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return false;
            }
            let scale = pivot.sqrt().recip();
            row[start + k..]
                .iter_mut()
                .for_each(|entry| *entry *= scale);
        }
        if count < PANEL {
            for (i, row) in rest.chunks_exact_mut(size).enumerate() {
                for finished in panel.chunks_exact(size) {
                    let column = start + count + i;
                    for j in column..size {
                        row[j] = multiply_add::<FUSED>(-finished[column], finished[j], row[j]);
                    }
                }
            }
            continue;
        }
        let mut pairs = rest.chunks_exact_mut(2 * size);
        let mut column = start + PANEL;
        for pair in pairs.by_ref() {
            let (one, other) = pair.split_at_mut(size);
            subtract::<FUSED, 2>(panel, size, column, [one, other]);
            column += 2;
        }
        if column < size {
            subtract::<FUSED, 1>(panel, size, column, [pairs.into_remainder()]);
        }
    }
    true
}

/// Subtracts the products of a whole panel from the rows that begin at the diagonal entry `column`.
#[inline(always)]
fn subtract<const FUSED: bool, const ROWS: usize>(
    panel: &[f64],
    size: usize,
    column: usize,
    mut rows: [&mut [f64]; ROWS],
) {
    let weights: [[f64; PANEL]; ROWS] =
        std::array::from_fn(|a| std::array::from_fn(|k| -panel[k * size + column + a]));
    let whole = column + (size - column) / LANES * LANES;
    for j in (column..whole).step_by(LANES) {
        let mut sums: [[f64; LANES]; ROWS] =
            std::array::from_fn(|a| rows[a][j..][..LANES].try_into().unwrap());
        for k in 0..PANEL {
            let source: &[f64; LANES] = panel[k * size + j..][..LANES].try_into().unwrap();
            for a in 0..ROWS {
                for lane in 0..LANES {
                    sums[a][lane] =
                        multiply_add::<FUSED>(weights[a][k], source[lane], sums[a][lane]);
                }
            }
        }
        for (row, sum) in rows.iter_mut().zip(&sums) {
            row[j..][..LANES].copy_from_slice(sum);
        }
    }
    for j in whole..size {
        for (row, weights) in rows.iter_mut().zip(&weights) {
            for k in 0..PANEL {
                row[j] = multiply_add::<FUSED>(weights[k], panel[k * size + j], row[j]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes around the panel; the rows of R and the Schur complement add up to the matrix.
    #[test]
    fn factor_and_complement_give_the_matrix() {
        for (size, pivots) in [
            (1, 1),
            (7, 7),
            (8, 8),
            (13, 10),
            (21, 16),
            (40, 33),
            (41, 41),
        ] {
            let table: Vec<f64> = (0..2 * size * size)
                .map(|i| f64::from(i as u32 * 37 % 101) / 50.0 - 1.0)
                .collect();
            let entry = |i: usize, j: usize| -> f64 {
                let products = table.chunks_exact(size).map(|row| row[i] * row[j]);
                products.sum::<f64>() + f64::from(u8::from(i == j))
            };
            let mut matrix: Vec<f64> = (0..size * size)
                .map(|index| entry(index / size, index % size))
                .collect();
            assert!(upper_factor(&mut matrix, size, pivots));
            for i in 0..size {
                for j in i..size {
                    let rows =
                        (0..pivots.min(i + 1)).map(|k| matrix[k * size + i] * matrix[k * size + j]);
                    let complement = if i < pivots {
                        0.0
                    } else {
                        matrix[i * size + j]
                    };
                    let sum = rows.sum::<f64>() + complement;
                    // rounding of sums of `size` products
                    assert!((sum - entry(i, j)).abs() < 1e-12 * size as f64);
                }
            }
        }
    }

    #[test]
    fn indefinite_matrix_has_no_factor() {
        assert!(!upper_factor(&mut [1.0, 2.0, 2.0, 1.0], 2, 2));
        assert!(upper_factor(&mut [1.0, 2.0, 2.0, 1.0], 2, 1));
    }
}
