//! Small symmetric positive definite systems.

use super::Real;

/// Solves a small symmetric positive definite system: Cramer's rule for two rows (one division),
/// L D L' beyond.
#[inline(always)]
pub(crate) fn solve<R: Real, const N: usize>(matrix: &[[R; N]; N], right: &[R; N]) -> [R; N] {
    let mut x = *right;
    if N == 1 {
        x[0] = right[0] / matrix[0][0];
    } else if N == 2 {
        let (a, b, d) = (matrix[0][0], matrix[0][1], matrix[1][1]);
        let scale = R::splat(1.0) / a.mul_add(d, -(b * b));
        x[0] = d.mul_add(right[0], -(b * right[1])) * scale;
        x[1] = a.mul_add(right[1], -(b * right[0])) * scale;
    } else {
        x = solve_ldl(matrix, right);
    }
    x
}

fn solve_ldl<R: Real, const N: usize>(matrix: &[[R; N]; N], right: &[R; N]) -> [R; N] {
    let mut l = *matrix;
    for j in 0..N {
        for k in 0..j {
            l[j][j] = l[j][j] - l[j][k] * l[j][k] * l[k][k];
        }
        for i in j + 1..N {
            for k in 0..j {
                l[i][j] = l[i][j] - l[i][k] * l[j][k] * l[k][k];
            }
            l[i][j] = l[i][j] / l[j][j];
        }
    }
    let mut x = *right;
    for i in 0..N {
        for k in 0..i {
            x[i] = x[i] - l[i][k] * x[k];
        }
    }
    for i in (0..N).rev() {
        x[i] = x[i] / l[i][i];
        for k in i + 1..N {
            x[i] = x[i] - l[k][i] * x[k];
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solves_what_it_multiplied(factor in prop::array::uniform9(-1.0..1.0f64), x in prop::array::uniform3(-2.0..2.0f64)) {
            let mut matrix = [[0.0; 3]; 3];
            for i in 0..3 {
                for j in 0..3 {
                    matrix[i][j] = (0..3).map(|k| factor[3 * i + k] * factor[3 * j + k]).sum::<f64>();
                }
                matrix[i][i] += 0.5;
            }
            let right: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| matrix[i][j] * x[j]).sum());
            let found = solve(&matrix, &right);
            for i in 0..3 {
                prop_assert!((found[i] - x[i]).abs() < 1e-12); // condition number below 10
            }
            let corner = [[matrix[0][0], matrix[0][1]], [matrix[1][0], matrix[1][1]]];
            let right = [corner[0][0] * x[0] + corner[0][1] * x[1], corner[1][0] * x[0] + corner[1][1] * x[1]];
            let (fast, general) = (solve(&corner, &right), solve_ldl(&corner, &right));
            for i in 0..2 {
                prop_assert!((fast[i] - x[i]).abs() < 1e-12);
                prop_assert!((general[i] - x[i]).abs() < 1e-12);
            }
        }
    }
}
