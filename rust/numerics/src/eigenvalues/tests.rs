//! Tests of the parent module.

use super::*;
use proptest::prelude::*;

/// Numbers between -1 and 1.
fn numbers(seed: u64, count: usize) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// A product of (n, n) matrices.
fn times(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let entry = |k: usize| (0..n).map(|i| a[k / n * n + i] * b[i * n + k % n]).sum();
    (0..n * n).map(entry).collect()
}

/// Largest distance between the closest pairs of two sets of complex numbers.
fn distance(values: &[[f64; 2]], expected: &[[f64; 2]]) -> f64 {
    let mut others = values.to_vec();
    let mut largest: f64 = 0.0;
    for [re, im] in expected {
        let far = |other: &[f64; 2]| (other[0] - re).hypot(other[1] - im);
        let closest = (0..others.len())
            .min_by(|&i, &j| far(&others[i]).total_cmp(&far(&others[j])))
            .expect("as many values");
        largest = largest.max(far(&others.swap_remove(closest)));
    }
    largest
}

proptest! {
    /// Blocks of two rows with known eigenvalues, after rotations: an orthogonal similarity.
    #[test]
    fn eigenvalues_are_those_of_the_blocks(
        blocks in 1usize..12,
        count in 1usize..20,
        seed in any::<u64>(),
    ) {
        let n = 2 * blocks;
        let draws = numbers(seed, count * (3 * n + blocks));
        let (mut matrices, mut expected) = (Vec::new(), Vec::new());
        for draws in draws.chunks_exact(3 * n + blocks) {
            let mut a = vec![0.0; n * n];
            for k in 0..blocks {
                let (i, [re, im, above]) = (2 * k, [0, 1, 2].map(|part| draws[3 * k + part]));
                a[i * n + i] = re;
                a[(i + 1) * n + i + 1] = if k % 3 == 0 { im } else { re };
                if k % 3 == 0 {
                    a[i * n + i + 1] = above;
                    expected.extend([[re, 0.0], [im, 0.0]]);
                } else {
                    a[i * n + i + 1] = im;
                    a[(i + 1) * n + i] = -im;
                    expected.extend([[re, im], [re, -im]]);
                }
            }
            for (k, turn) in draws[n + blocks..].iter().enumerate() {
                let (i, j) = (k % n, (k + 1 + k / n) % n);
                if i == j {
                    continue;
                }
                let unit = |k: usize| f64::from(k / n == k % n);
                let mut rotation: Vec<f64> = (0..n * n).map(unit).collect();
                let (sine, cosine) = (3.0 * turn).sin_cos();
                rotation[i * n + i] = cosine;
                rotation[j * n + j] = cosine;
                rotation[i * n + j] = sine;
                let mut inverse = rotation.clone();
                rotation[j * n + i] = -sine;
                inverse[j * n + i] = sine;
                inverse[i * n + j] = -sine;
                a = times(&times(&rotation, &a, n), &inverse, n);
            }
            matrices.extend(a);
        }
        let values = eigenvalues(&matrices, n).expect("finite matrices");
        for (values, expected) in values.chunks(n).zip(expected.chunks(n)) {
            // close eigenvalues of a block with an entry above have errors of the root of rounding
            prop_assert!(distance(values, expected) < 1e-7);
        }
    }

    /// Sums of eigenvalues and of their squares are traces of the matrix and of its square.
    #[test]
    fn sums_are_traces(n in 1usize..40, count in 1usize..12, seed in any::<u64>()) {
        let matrices = numbers(seed, count * n * n);
        let values = eigenvalues(&matrices, n).expect("finite matrices");
        for (a, values) in matrices.chunks(n * n).zip(values.chunks(n)) {
            let square = times(a, a, n);
            let trace = |a: &[f64]| -> f64 { (0..n).map(|i| a[i * n + i]).sum() };
            let sum: f64 = values.iter().map(|[re, _]| re).sum();
            let squares: f64 = values.iter().map(|[re, im]| re * re - im * im).sum();
            prop_assert!((sum - trace(a)).abs() < 1e-12 * n as f64);
            prop_assert!((squares - trace(&square)).abs() < 1e-11 * n as f64);
        }
    }
}

/// Cycles of n coordinates: roots of one, which plain shifts do not separate.
#[test]
fn cycles_have_the_roots_of_one() {
    for n in 1..40 {
        let matrix: Vec<f64> = (0..n * n)
            .map(|k| f64::from((k / n + 1) % n == k % n))
            .collect();
        let root = |k: usize| {
            let (sine, cosine) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
            [cosine, sine]
        };
        let expected: Vec<[f64; 2]> = (0..n).map(root).collect();
        assert!(distance(&eigenvalues(&matrix, n).unwrap(), &expected) < 1e-13 * n as f64);
    }
}

/// Balancing: rows and columns in units that differ by powers of ten.
#[test]
fn units_do_not_matter() {
    let n = 12;
    let plain = numbers(3, n * n);
    let unit = |k: usize| 10f64.powi(k as i32 * 3 - 16);
    let scaled: Vec<f64> = (0..n * n)
        .map(|k| plain[k] * unit(k / n) / unit(k % n))
        .collect();
    let expected = eigenvalues(&plain, n).unwrap();
    assert!(distance(&eigenvalues(&scaled, n).unwrap(), &expected) < 1e-12);
}

#[test]
fn what_is_not_finite_has_no_eigenvalues() {
    for n in [1, 2, 3, 8] {
        for value in [f64::NAN, f64::INFINITY] {
            let mut matrix = numbers(1, n * n);
            matrix[n * n - 1] = value;
            assert!(eigenvalues(&matrix, n).is_none());
        }
    }
}

/// Half of the eigenvalues are nearly equal, and smaller than the others.
#[test]
fn small_equal_eigenvalues_converge() {
    let n = 24;
    for seed in 0..50 {
        let similar = numbers(seed, n * n);
        let mut matrix: Vec<f64> = similar.iter().map(|value| 1e-14 * value).collect();
        for k in 0..n {
            matrix[k * n + k] += if k < 12 { 2e-3 } else { 1.0 / (1.0 + k as f64) };
        }
        let values = eigenvalues(&matrix, n).unwrap();
        assert_eq!(
            values
                .iter()
                .filter(|[re, im]| re.hypot(*im) < 3e-3)
                .count(),
            12
        );
    }
}

/// Sparse matrices have zero eigenvalues with few vectors, which converge slowly.
#[test]
fn nilpotent_blocks_converge() {
    let n = 14;
    for seed in 0..200 {
        let draws = numbers(seed, n * n);
        let is_kept = |k: usize| ((draws[k] * 1e3).abs() as usize).is_multiple_of(12);
        let sparse: Vec<f64> = (0..n * n)
            .map(|k| if is_kept(k) { draws[k] } else { 0.0 })
            .collect();
        assert!(eigenvalues(&sparse, n).is_some());
    }
}

/// Skew matrices have no diagonal with which entries left of it are compared, and imaginary pairs.
#[test]
fn skew_matrices_have_imaginary_eigenvalues() {
    for n in 2..40 {
        let draws = numbers(n as u64, n * n);
        let skew: Vec<f64> = (0..n * n)
            .map(|k| draws[k] - draws[k % n * n + k / n])
            .collect();
        let values = eigenvalues(&skew, n).unwrap();
        let squares: f64 = values.iter().map(|[_, im]| im * im).sum();
        let norm: f64 = skew.iter().map(|entry| entry * entry).sum();
        assert!(values.iter().all(|[re, _]| re.abs() < 1e-13 * n as f64));
        assert!((squares - norm).abs() < 1e-12 * norm);
    }
}
