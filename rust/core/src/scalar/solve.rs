//! Small symmetric positive definite systems.

use super::{Real, run_out_of_line, works};

/// Solves a small symmetric positive definite system of `n` rows, by Cramer's rule for two rows (one
/// division) and by elimination for more, which reads the rows up to the diagonal.
#[inline(always)]
pub(crate) fn solve<R: Real, const N: usize>(
    matrix: &[[R; N]; N],
    right: &[R; N],
    (n, outlined): (usize, bool),
) -> [R; N] {
    let mut x = *right;
    if N == 1 {
        x[0] = right[0] / matrix[0][0];
    } else if N == 2 {
        let (a, b, d) = (matrix[0][0], matrix[0][1], matrix[1][1]);
        let scale = R::splat(1.0) / a.mul_add(d, -(b * b));
        x[0] = d.mul_add(right[0], -(b * right[1])) * scale;
        x[1] = a.mul_add(right[1], -(b * right[0])) * scale;
    } else if outlined {
        x = run_out_of_line::<R, _>(SolveWork(matrix, right, n));
    } else {
        x = eliminate(matrix, right, n);
    }
    x
}

/// Inverse of a small symmetric positive definite matrix, times a factor.
#[inline(always)]
pub(crate) fn inverse<R: Real, const N: usize>(
    matrix: &[[R; N]; N],
    factor: R,
    n: usize,
) -> [[R; N]; N] {
    if N > 2 {
        return run_out_of_line::<R, _>(InverseWork(matrix, factor, n));
    }
    let mut all = [[R::splat(0.0); N]; N];
    for j in 0..N {
        let mut column = [R::splat(0.0); N];
        column[j] = factor;
        // the matrix is symmetric, so its columns are its rows
        all[j] = solve(matrix, &column, (n, true));
    }
    all
}

/// Places of a row in [`eliminate`], whole packs.
const ROOM: usize = 8;

/// Gaussian elimination without pivots from the last row on, the rows in packs. Reads the rows up to
/// the diagonal: a pack loaded from numbers that were just stored one by one would wait for them,
/// so no number is copied across the diagonal.
#[inline(always)]
fn eliminate<R: Real, const N: usize>(matrix: &[[R; N]; N], right: &[R; N], n: usize) -> [R; N] {
    const { assert!(N <= ROOM) };
    let mut rows = [[R::splat(0.0); ROOM]; N];
    for i in 0..n {
        rows[i][..N].copy_from_slice(&matrix[i]);
    }
    let (mut x, mut per_pivot) = (*right, *right);
    for j in (2..n).rev() {
        per_pivot[j] = R::splat(1.0) / rows[j][j];
        for i in 0..j {
            let factor = -rows[j][i] * per_pivot[j];
            x[i] = factor.mul_add(x[j], x[i]);
            for first in (0..i + 1).step_by(R::PACKED) {
                let row = R::pack(&rows[j][first..]);
                let rest = factor.spread().mul_add(row, R::pack(&rows[i][first..]));
                R::unpack(rest, &mut rows[i][first..]);
            }
        }
    }
    if n < 2 {
        x[0] = x[0] / rows[0][0];
        return x;
    }
    // the first two rows with one division
    let (a, b, d) = (rows[0][0], rows[1][0], rows[1][1]);
    let scale = R::splat(1.0) / a.mul_add(d, -(b * b));
    (x[0], x[1]) = (
        d.mul_add(x[0], -(b * x[1])) * scale,
        a.mul_add(x[1], -(b * x[0])) * scale,
    );
    for i in 2..n {
        for k in 0..i {
            x[i] = (-rows[i][k]).mul_add(x[k], x[i]);
        }
        x[i] = x[i] * per_pivot[i];
    }
    x
}

/// Copies the rows up to the diagonal to the columns.
#[inline(always)]
pub(crate) fn symmetrise<R: Real, const N: usize>(matrix: &mut [[R; N]; N]) {
    for i in 0..N {
        for j in 0..i {
            matrix[j][i] = matrix[i][j];
        }
    }
}

/// [`inverse`] for more than two rows.
#[inline(always)]
fn inverse_by_factor<R: Real, const N: usize>(
    matrix: &[[R; N]; N],
    scale: R,
    n: usize,
) -> [[R; N]; N] {
    let (l, per_d) = factorise(matrix, n);
    let mut all = *matrix;
    for j in 0..n {
        // entries of column j from the diagonal on; those before follow by symmetry
        let mut x = [R::splat(0.0); N];
        x[j] = scale;
        for i in j + 1..n {
            for k in j..i {
                x[i] = (-l[i][k]).mul_add(x[k], x[i]);
            }
        }
        for i in (j..n).rev() {
            x[i] = x[i] * per_d[i];
            for k in i + 1..n {
                x[i] = (-l[k][i]).mul_add(x[k], x[i]);
            }
        }
        for i in j..n {
            all[j][i] = x[i];
            all[i][j] = x[i];
        }
    }
    all
}

works! {
    ['m, R: Real, const N: usize] ['m, R, N]
    /// [`eliminate`].
    SolveWork(0: &'m [[R; N]; N], 1: &'m [R; N], 2: usize) -> [R; N] = eliminate;
    /// [`inverse_by_factor`].
    InverseWork(0: &'m [[R; N]; N], 1: R, 2: usize) -> [[R; N]; N] = inverse_by_factor;
}

/// L below the diagonal, and 1/D.
#[inline(always)]
fn factorise<R: Real, const N: usize>(matrix: &[[R; N]; N], n: usize) -> ([[R; N]; N], [R; N]) {
    let mut l = *matrix;
    let mut per_d = [R::splat(0.0); N];
    for j in 0..n {
        // row j times D, computed so far
        let mut scaled = l[j];
        for k in 0..j {
            scaled[k] = l[j][k] * l[k][k];
            l[j][j] = (-l[j][k]).mul_add(scaled[k], l[j][j]);
        }
        per_d[j] = R::splat(1.0) / l[j][j];
        for i in j + 1..n {
            for k in 0..j {
                l[i][j] = (-l[i][k]).mul_add(scaled[k], l[i][j]);
            }
            l[i][j] = l[i][j] * per_d[j];
        }
    }
    (l, per_d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solve_inverts_multiplication(factor in prop::array::uniform9(-1.0..1.0f64), x in prop::array::uniform3(-2.0..2.0f64)) {
            let mut matrix = [[0.0; 3]; 3];
            for i in 0..3 {
                for j in 0..3 {
                    matrix[i][j] = (0..3).map(|k| factor[3 * i + k] * factor[3 * j + k]).sum::<f64>();
                }
                matrix[i][i] += 0.5;
            }
            let right: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| matrix[i][j] * x[j]).sum());
            let actual = solve(&matrix, &right, (3, true));
            let inverse = inverse(&matrix, 2.0, 3);
            for i in 0..3 {
                let row: f64 = (0..3).map(|j| inverse[i][j] * right[j]).sum();
                prop_assert!((row - 2.0 * x[i]).abs() < 1e-11); // the condition number enters twice
                prop_assert!((actual[i] - x[i]).abs() < 1e-12); // condition number below 10
            }
            let corner = [[matrix[0][0], matrix[0][1]], [matrix[1][0], matrix[1][1]]];
            let right = [corner[0][0] * x[0] + corner[0][1] * x[1], corner[1][0] * x[0] + corner[1][1] * x[1]];
            let (fast, inverse) = (solve(&corner, &right, (2, true)), inverse_by_factor(&corner, 1.0, 2));
            for i in 0..2 {
                prop_assert!((fast[i] - x[i]).abs() < 1e-12);
                let general = inverse[i][0] * right[0] + inverse[i][1] * right[1];
                prop_assert!((general - x[i]).abs() < 1e-12);
            }
        }
    }
}
