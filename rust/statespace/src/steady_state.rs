//! Steady states of linear models, by doubling: each step squares the number of samples, so that
//! convergence is quadratic. Matrices are row-major.

use crate::linalg::inverse;

/// Largest number of doublings.
const MAX_DOUBLINGS: usize = 60;

/// Largest change of a Gramian, relative to its largest entry, that counts as converged.
const GRAMIAN_TOLERANCE: f64 = 1e-15;

/// The same for the covariance of the state.
const COVARIANCE_TOLERANCE: f64 = 1e-14;

/// Solution X (n, n) of X = A X A' + B B' for stable A (n, n) and B (n, m).
pub fn gramian(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut x = product(b, &transposed(b, n), n);
    let mut power = a.to_vec();
    for _ in 0..MAX_DOUBLINGS {
        let increment = product(&product(&power, &x, n), &transposed(&power, n), n);
        add(&mut x, &increment);
        if has_converged(&increment, &x, GRAMIAN_TOLERANCE) {
            break;
        }
        power = product(&power, &power, n);
    }
    symmetric(&x, n)
}

/// Noise of x+ = A x + w, y = C x + v: cov [w; v] = [Q S; S' R].
#[derive(Clone, Copy, Debug)]
pub struct Noise<'a> {
    /// Q, (n, n).
    pub state: &'a [f64],
    /// S, (n, p).
    pub cross: &'a [f64],
    /// R, (p, p).
    pub output: &'a [f64],
}

/// Gain K (n, p) of the steady-state Kalman predictor, and covariance C P C' + R (p, p) of its
/// innovations.
///
/// ```text
/// P = A P A' + Q - K (C P C' + R) K',   K = (A P C' + S) (C P C' + R)^-1
/// ```
///
/// by the structure-preserving doubling algorithm (Anderson, Int. J. Control 28, 1978). A - K C is
/// stable if the noise excites all modes on or outside the unit circle. `None` if R or C P C' + R
/// is not positive definite, or if the iteration diverges.
pub fn innovations_gain(
    a: &[f64],
    c: &[f64],
    noise: Noise<'_>,
    n: usize,
    p: usize,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let (output_inverse, _) = inverse(noise.output.to_vec(), p)?;
    // S R^-1 C, S R^-1 S' and C' R^-1 C
    let cross = product(noise.cross, &output_inverse, n);
    let mut transition = a.to_vec();
    subtract(&mut transition, &product(&cross, c, n));
    let mut f = transposed(&transition, n);
    let c_transposed = transposed(c, p);
    let mut g = product(&product(&c_transposed, &output_inverse, n), c, n);
    let mut x = noise.state.to_vec();
    subtract(&mut x, &product(&cross, &transposed(noise.cross, n), n));
    for _ in 0..MAX_DOUBLINGS {
        let mut sum = product(&g, &x, n);
        (0..n).for_each(|i| sum[i * n + i] += 1.0);
        let (inverse, _) = inverse(sum, n)?;
        let (of_f, of_g) = (product(&inverse, &f, n), product(&inverse, &g, n));
        let f_transposed = transposed(&f, n);
        let increment = symmetric(&product(&product(&f_transposed, &x, n), &of_f, n), n);
        add(&mut g, &product(&product(&f, &of_g, n), &f_transposed, n));
        f = product(&f, &of_f, n);
        add(&mut x, &increment);
        if has_converged(&increment, &x, COVARIANCE_TOLERANCE) {
            break;
        }
    }
    let mut covariance = product(&product(c, &x, p), &c_transposed, p);
    add(&mut covariance, noise.output);
    let mut gain = product(&product(a, &x, n), &c_transposed, n);
    add(&mut gain, noise.cross);
    let (covariance_inverse, _) = inverse(covariance.clone(), p)?;
    Some((product(&gain, &covariance_inverse, n), covariance))
}

/// Whether an increment is small against a sum, or one of them is not a number.
fn has_converged(increment: &[f64], sum: &[f64], tolerance: f64) -> bool {
    let is_finite = increment.iter().chain(sum).all(|entry| entry.is_finite());
    let largest = |entries: &[f64]| entries.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
    !is_finite || largest(increment) <= tolerance * largest(sum)
}

/// Product of a matrix of `rows` rows with another matrix.
fn product(left: &[f64], right: &[f64], rows: usize) -> Vec<f64> {
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
fn transposed(matrix: &[f64], rows: usize) -> Vec<f64> {
    let columns = matrix.len() / rows;
    (0..columns * rows)
        .map(|index| matrix[index % rows * columns + index / rows])
        .collect()
}

/// Mean of a square matrix and its transpose.
fn symmetric(matrix: &[f64], n: usize) -> Vec<f64> {
    let other = transposed(matrix, n);
    matrix
        .iter()
        .zip(other)
        .map(|(a, b)| 0.5 * (a + b))
        .collect()
}

fn add(target: &mut [f64], change: &[f64]) {
    target.iter_mut().zip(change).for_each(|(t, c)| *t += c);
}

fn subtract(target: &mut [f64], change: &[f64]) {
    target.iter_mut().zip(change).for_each(|(t, c)| *t -= c);
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [f64; 4] = [0.9, 0.3, -0.2, 0.7];
    const C: [f64; 2] = [1.0, 0.5];

    fn assert_close(left: &[f64], right: &[f64]) {
        for (l, r) in left.iter().zip(right) {
            assert!((l - r).abs() < 1e-12, "{left:?} {right:?}");
        }
    }

    #[test]
    fn gramian_satisfies_its_equation() {
        let b = [0.4, 1.0, -0.3, 0.2, 0.0, 0.7];
        let x = gramian(&A, &b, 2);
        let mut expected = product(&product(&A, &x, 2), &transposed(&A, 2), 2);
        add(&mut expected, &product(&b, &transposed(&b, 2), 2));
        assert_close(&x, &expected);
    }

    /// The covariance of the innovations of x+ = A x + K e, y = C x + e is that of e.
    #[test]
    fn gain_of_innovations_form_is_recovered() {
        let (gain, variance) = ([0.3, -0.1], [2.0]);
        let cross = product(&gain, &variance, 2);
        let noise = Noise {
            state: &product(&cross, &transposed(&gain, 2), 2),
            cross: &cross,
            output: &variance,
        };
        let (k, covariance) = innovations_gain(&A, &C, noise, 2, 1).unwrap();
        assert_close(&k, &gain);
        assert_close(&covariance, &variance);
    }

    #[test]
    fn singular_output_noise_has_no_gain() {
        let noise = Noise {
            state: &[1.0, 0.0, 0.0, 1.0],
            cross: &[0.0; 2],
            output: &[0.0],
        };
        assert!(innovations_gain(&A, &C, noise, 2, 1).is_none());
    }
}
