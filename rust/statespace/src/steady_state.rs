//! Steady states of linear models, by doubling: each step squares the number of samples, so that
//! convergence is quadratic. Matrices are row-major.

use crate::linalg::{cholesky, inverse, product, solve_lower_transposed, transposed};
use crate::model::Model;
use crate::stability::is_stable;
use strainwave_numerics::singular;

/// Largest number of doublings.
const MAX_DOUBLINGS: usize = 60;

/// Largest change of a Gramian, relative to its largest entry, that counts as converged.
const GRAMIAN_TOLERANCE: f64 = 1e-15;

/// The same for the covariance of the state.
const COVARIANCE_TOLERANCE: f64 = 1e-14;

/// Process noise that a stabilising gain assumes on every state in successive attempts, relative to
/// the mean variance of the innovations.
const PROCESS_NOISE_SHARES: [f64; 4] = [1e-9, 1e-6, 1e-3, 1.0];

/// Smallest square of a Hankel singular value relative to the largest; smaller ones are rounding.
const MIN_HANKEL_SQUARE_RATIO: f64 = 1e-24;

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

/// Gain K, or the gain of the stable predictor with the same noise spectrum.
///
/// K (n, p) is returned if A - K C is stable. Otherwise the Riccati equation with w = K e and v = e
/// gives the stable predictor, for innovations e with a `covariance` (p, p). A small process noise
/// on every state moves eigenvalues away from the unit circle.
pub fn stabilising_gain(
    a: &[f64],
    c: &[f64],
    mut gain: Vec<f64>,
    covariance: &[f64],
    n: usize,
    p: usize,
) -> Vec<f64> {
    let scale = (0..p).map(|o| covariance[o * p + o]).sum::<f64>() / p as f64;
    for share in PROCESS_NOISE_SHARES {
        let mut predictor = a.to_vec();
        subtract(&mut predictor, &product(&gain, c, n));
        if is_stable(&predictor, n) {
            break;
        }
        let cross = product(&gain, covariance, n);
        let mut state = product(&cross, &transposed(&gain, n), n);
        (0..n).for_each(|i| state[i * n + i] += share * scale);
        let noise = Noise {
            state: &state,
            cross: &cross,
            output: covariance,
        };
        gain = innovations_gain(a, c, noise, n, p).map_or(vec![f64::NAN; n * p], |(gain, _)| gain);
    }
    gain
}

/// State transformation T that balances the predictor, and its inverse.
///
/// In the coordinates T x, the controllability and observability Gramians of (A - K C, [B, K], C)
/// are equal and diagonal, which keeps the normal equations of a fit well conditioned. `None` if the
/// predictor is unstable or a Gramian is singular.
pub fn balancing(model: &Model) -> Option<(Vec<f64>, Vec<f64>)> {
    let (n, m, p) = (model.shape.order, model.shape.inputs, model.shape.outputs);
    let predictor = model.predictor_matrix();
    if !is_stable(&predictor, n) {
        return None;
    }
    let rows = model.b().chunks_exact(m).zip(model.k().chunks_exact(p));
    let driven: Vec<f64> = rows.flat_map(|(b, k)| [b, k].concat()).collect();
    let lower = cholesky(&gramian(&predictor, &driven, n), n)?;
    let observability = gramian(&transposed(&predictor, n), &transposed(model.c(), p), n);
    let weighted = product(
        &product(&transposed(&lower, n), &observability, n),
        &lower,
        n,
    );
    // squares of the Hankel singular values
    let singular::Decomposition { values, right, .. } = singular::decompose(&weighted, n, &[]);
    let is_minimal = values[n - 1] > MIN_HANKEL_SQUARE_RATIO * values[0];
    if !is_minimal {
        return None;
    }
    // T = S^(1/2) U' L^-1, where S holds the Hankel singular values, in ascending order
    let (mut forward, mut backward) = (vec![], vec![0.0; n * n]);
    for (k, &square) in values.iter().rev().enumerate() {
        let root = square.sqrt().sqrt();
        let mut row = right[(n - 1 - k) * n..][..n].to_vec();
        for (i, entry) in product(&lower, &row, n).into_iter().enumerate() {
            backward[i * n + k] = entry / root;
        }
        solve_lower_transposed(&lower, n, &mut row);
        forward.extend(row.into_iter().map(|entry| root * entry));
    }
    Some((forward, backward))
}

/// Transforms a model to the coordinates of [`balancing`], if they exist.
pub fn balance(model: &mut Model) {
    let Some((forward, backward)) = balancing(model) else {
        return;
    };
    let (shape, n) = (model.shape, model.shape.order);
    let a = product(&product(&forward, model.a(), n), &backward, n);
    let b = product(&forward, model.b(), n);
    let c = product(model.c(), &backward, shape.outputs);
    let k = product(&forward, model.k(), n);
    for (range, part) in [
        (shape.a(), a),
        (shape.b(), b),
        (shape.c(), c),
        (shape.k(), k),
    ] {
        model.values[range].copy_from_slice(&part);
    }
    for state in model.values[shape.entries()..].chunks_exact_mut(n) {
        state.copy_from_slice(&product(&forward, state, n));
    }
}

/// Whether an increment is small against a sum, or one of them is not a number.
fn has_converged(increment: &[f64], sum: &[f64], tolerance: f64) -> bool {
    let is_finite = increment.iter().chain(sum).all(|entry| entry.is_finite());
    let largest = |entries: &[f64]| entries.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
    !is_finite || largest(increment) <= tolerance * largest(sum)
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
    use crate::model::Shape;

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

    /// An unstable predictor is replaced by one whose noise has the same spectrum: for a first-order
    /// model, that of the reflected zero, a - k = 1 / 2 instead of 2.
    #[test]
    fn gain_of_unstable_predictor_reflects_the_zero() {
        let gain = stabilising_gain(&[0.8], &[1.0], vec![-1.2], &[1.0], 1, 1);
        // process noise of 1e-9
        assert!((gain[0] - 0.3).abs() < 1e-9);
        assert_close(
            &stabilising_gain(&[0.8], &[1.0], vec![0.1], &[1.0], 1, 1),
            &[0.1],
        );
    }

    #[test]
    fn balanced_model_has_equal_diagonal_gramians() {
        let shape = Shape {
            order: 2,
            inputs: 1,
            outputs: 1,
        };
        let values = [&A[..], &[0.4, 1.0], &C, &[0.2], &[0.3, -0.1], &[1.0, 2.0]].concat();
        let mut model = Model { shape, values };
        let (forward, backward) = balancing(&model).unwrap();
        assert_close(&product(&forward, &backward, 2), &[1.0, 0.0, 0.0, 1.0]);
        balance(&mut model);
        let (f, b, k) = (model.predictor_matrix(), model.b(), model.k());
        let x = gramian(&f, &[b[0], k[0], b[1], k[1]], 2);
        assert_close(&x, &gramian(&transposed(&f, 2), model.c(), 2));
        assert!(x[1].abs() < 1e-12 && x[0] < x[3]);
        assert_close(&product(&backward, model.initial_state(0), 2), &[1.0, 2.0]);
        model.values[shape.a()].copy_from_slice(&[2.0, 0.0, 0.0, 2.0]);
        assert!(balancing(&model).is_none());
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
