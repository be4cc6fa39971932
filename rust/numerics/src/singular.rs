//! Singular value decomposition of a square matrix of at most a few hundred rows.
//!
//! Householder reflections reduce the matrix to an upper bidiagonal one, and implicitly shifted QR
//! steps make that one diagonal (Golub and Reinsch, Numerische Mathematik 14, 1970). Rotations from
//! the left are applied to right-hand sides only, so the left singular vectors are never formed.

use crate::products::{BASELINE_IS_FUSED, multiply_add};

/// Largest number of QR steps per singular value; two are usual.
const MAX_STEPS: usize = 100;

/// Lanes of a sum, so that no sum waits for the previous one.
const LANES: usize = 8;

/// Decomposition U diag(values) V' of a square matrix.
pub struct Decomposition {
    /// Singular values (n,), descending.
    pub values: Vec<f64>,
    /// V', one right singular vector per row: (n, n) row-major.
    pub right: Vec<f64>,
    /// U' times the right-hand sides: (n, sides) row-major.
    pub left: Vec<f64>,
}

/// Decomposes a row-major matrix (n, n); `sides` (n, any) are right-hand sides.
///
/// Errors are of the order of rounding times the largest singular value.
///
/// # Panics
/// The matrix has entries that are not finite.
pub fn decompose(matrix: &[f64], n: usize, sides: &[f64]) -> Decomposition {
    assert_eq!(matrix.len(), n * n);
    assert_eq!(sides.len() % n.max(1), 0);
    let mut work = Work {
        n,
        width: sides.len() / n.max(1),
        matrix: matrix.to_vec(),
        left: sides.to_vec(),
        right: vec![0.0; n * n],
        diagonal: vec![0.0; n],
        above: vec![0.0; n],
        reflections: vec![0.0; n],
    };
    work.run();
    work.sorted()
}

/// Solution x (n, sides) of least norm of the least-squares problem R x = b with square R (n, n).
///
/// Singular values of at most `tolerance` times the largest one count as zero.
pub fn solve(matrix: &[f64], n: usize, sides: &[f64], tolerance: f64) -> Vec<f64> {
    let Decomposition {
        values,
        right,
        left,
    } = decompose(matrix, n, sides);
    let width = sides.len() / n.max(1);
    let mut solution = vec![0.0; n * width];
    for k in (0..n).filter(|&k| values[k] > tolerance * values[0]) {
        for i in 0..n {
            let weight = right[k * n + i] / values[k];
            for j in 0..width {
                solution[i * width + j] += weight * left[k * width + j];
            }
        }
    }
    solution
}

struct Work {
    n: usize,
    width: usize,
    /// The matrix; the tail of row k becomes the reflection of its entries beyond the bidiagonal.
    matrix: Vec<f64>,
    left: Vec<f64>,
    right: Vec<f64>,
    diagonal: Vec<f64>,
    /// Entry k is above diagonal entry k + 1.
    above: Vec<f64>,
    /// Factors of the reflections from the right.
    reflections: Vec<f64>,
}

impl Work {
    /// Uses vectors if the processor has them, decided at run time on x86-64.
    fn run(&mut self) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: all features have just been detected.
                return unsafe { self.run_avx512() };
            }
            // SAFETY: both features have just been detected.
            return unsafe { self.run_avx2() };
        }
        self.run_with::<BASELINE_IS_FUSED>();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,avx512f")]
    fn run_avx512(&mut self) {
        self.run_with::<true>();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&mut self) {
        self.run_with::<true>();
    }

    #[inline(always)]
    fn run_with<const FUSED: bool>(&mut self) {
        self.reduce::<FUSED>();
        self.diagonalise::<FUSED>();
        // V' of the bidiagonal matrix times the reflections, last one first
        for k in (0..self.n.saturating_sub(1)).rev() {
            let vector = &self.matrix[k * self.n + k + 1..(k + 1) * self.n];
            for row in self.right.chunks_exact_mut(self.n) {
                let weight = -self.reflections[k] * dot::<FUSED>(vector, &row[k + 1..]);
                add_scaled::<FUSED>(&mut row[k + 1..], weight, vector);
            }
        }
    }

    /// Upper bidiagonal form U' A V.
    #[inline(always)]
    fn reduce<const FUSED: bool>(&mut self) {
        let (n, width) = (self.n, self.width);
        let mut sums = vec![0.0; n + width];
        let mut column = vec![0.0; n];
        for k in 0..n {
            for i in k..n {
                column[i] = self.matrix[i * n + k];
            }
            let (factor, value) = reflection::<FUSED>(&mut column[k..]);
            self.diagonal[k] = value;
            sums.fill(0.0);
            let (of_matrix, of_sides) = sums.split_at_mut(n);
            for i in k..n {
                let weight = factor * column[i];
                add_scaled::<FUSED>(
                    &mut of_matrix[k + 1..],
                    weight,
                    &self.matrix[i * n + k + 1..(i + 1) * n],
                );
                add_scaled::<FUSED>(of_sides, weight, &self.left[i * width..][..width]);
            }
            for i in k..n {
                let row = &mut self.matrix[i * n + k + 1..(i + 1) * n];
                add_scaled::<FUSED>(row, -column[i], &of_matrix[k + 1..]);
                add_scaled::<FUSED>(&mut self.left[i * width..][..width], -column[i], of_sides);
            }
            if k + 1 == n {
                break;
            }
            let (done, rest) = self.matrix.split_at_mut((k + 1) * n);
            let vector = &mut done[k * n + k + 1..];
            let (factor, value) = reflection::<FUSED>(vector);
            self.above[k] = value;
            self.reflections[k] = factor;
            for row in rest.chunks_exact_mut(n) {
                let weight = -factor * dot::<FUSED>(vector, &row[k + 1..]);
                add_scaled::<FUSED>(&mut row[k + 1..], weight, vector);
            }
        }
    }

    /// QR steps on the bidiagonal matrix; the rotations from the right begin with the identity.
    #[inline(always)]
    fn diagonalise<const FUSED: bool>(&mut self) {
        let n = self.n;
        for i in 0..n {
            self.right[i * n + i] = 1.0;
        }
        let entries = self.diagonal.iter().zip(&self.above);
        let norm = entries.fold(0.0_f64, |norm, (d, e)| norm.max(d.abs() + e.abs()));
        let negligible = f64::EPSILON * norm;
        for last in (0..n).rev() {
            let mut steps = 0;
            while let Some(first) = self.block::<FUSED>(last, negligible) {
                assert!(steps < MAX_STEPS, "expected a finite matrix");
                steps += 1;
                self.step::<FUSED>(first, last);
            }
        }
    }

    /// First row of the block that ends at `last`; `None` if the block is a single entry.
    #[inline(always)]
    fn block<const FUSED: bool>(&mut self, last: usize, negligible: f64) -> Option<usize> {
        let mut first = last;
        while first > 0 && self.above[first - 1].abs() > negligible {
            if self.diagonal[first - 1].abs() <= negligible {
                self.clear_row::<FUSED>(first, last, negligible);
                break;
            }
            first -= 1;
        }
        (first < last).then_some(first)
    }

    /// Annihilates the entry above diagonal entry `first`, whose row has a zero on the diagonal.
    #[inline(always)]
    fn clear_row<const FUSED: bool>(&mut self, first: usize, last: usize, negligible: f64) {
        let mut bulge = std::mem::take(&mut self.above[first - 1]);
        for i in first..=last {
            if bulge.abs() <= negligible {
                return;
            }
            let (c, s, value) = rotation(self.diagonal[i], bulge);
            self.diagonal[i] = value;
            rotate::<FUSED>(&mut self.left, self.width, i, first - 1, c, s);
            if i < last {
                bulge = -s * self.above[i];
                self.above[i] *= c;
            }
        }
    }

    /// QR step of rows `first` to `last` with the shift of the last two columns.
    #[inline(always)]
    fn step<const FUSED: bool>(&mut self, first: usize, last: usize) {
        let (d, e) = (&mut self.diagonal, &mut self.above);
        let (y, z, h) = (d[last - 1], d[last], e[last - 1]);
        let g = if last - 1 > first { e[last - 2] } else { 0.0 };
        let mean = ((y - z) * (y + z) + (g - h) * (g + h)) / (2.0 * h * y);
        let root = mean.hypot(1.0).copysign(mean);
        let x = d[first];
        // the first column of B'B minus the shift, divided by x
        let mut f = ((x - z) * (x + z) + h * (y / (mean + root) - h)) / x;
        let mut bulge = e[first];
        for j in first..last {
            let (c, s, value) = rotation(f, bulge);
            if j > first {
                e[j - 1] = value;
            }
            rotate::<FUSED>(&mut self.right, self.n, j, j + 1, c, s);
            f = c * d[j] + s * e[j];
            e[j] = c * e[j] - s * d[j];
            bulge = s * d[j + 1];
            d[j + 1] *= c;
            let (c, s, value) = rotation(f, bulge);
            d[j] = value;
            rotate::<FUSED>(&mut self.left, self.width, j, j + 1, c, s);
            f = c * e[j] + s * d[j + 1];
            d[j + 1] = c * d[j + 1] - s * e[j];
            if j + 1 < last {
                bulge = s * e[j + 1];
                e[j + 1] *= c;
            }
        }
        e[last - 1] = f;
    }

    fn sorted(self) -> Decomposition {
        let (n, width) = (self.n, self.width);
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&i, &j| self.diagonal[j].abs().total_cmp(&self.diagonal[i].abs()));
        let mut right = Vec::with_capacity(n * n);
        let mut left = Vec::with_capacity(n * width);
        for &i in &order {
            let sign = 1.0_f64.copysign(self.diagonal[i]);
            right.extend(self.right[i * n..][..n].iter().map(|entry| sign * entry));
            left.extend_from_slice(&self.left[i * width..][..width]);
        }
        Decomposition {
            values: order.iter().map(|&i| self.diagonal[i].abs()).collect(),
            right,
            left,
        }
    }
}

/// Replaces x by the vector v of the reflection I - factor v v' that maps x to (value, 0, ..., 0).
/// Returns the factor and the value.
#[inline(always)]
fn reflection<const FUSED: bool>(x: &mut [f64]) -> (f64, f64) {
    let scale = x
        .iter()
        .fold(0.0_f64, |scale, entry| scale.max(entry.abs()));
    if scale == 0.0 {
        return (0.0, 0.0);
    }
    x.iter_mut().for_each(|entry| *entry /= scale);
    let square = dot::<FUSED>(x, x);
    let value = -square.sqrt().copysign(x[0]);
    x[0] -= value;
    // v'v = 2 value^2 - 2 value x[0]
    (-1.0 / (value * x[0]), scale * value)
}

/// Rotation with c f + s g = value and c g - s f = 0.
#[inline(always)]
fn rotation(f: f64, g: f64) -> (f64, f64, f64) {
    let value = (f * f + g * g).sqrt();
    if value > 0.0 {
        let inverse = value.recip();
        (f * inverse, g * inverse, value)
    } else {
        (1.0, 0.0, 0.0)
    }
}

/// Rows i and j of a matrix with `width` columns become c i + s j and c j - s i.
#[inline(always)]
fn rotate<const FUSED: bool>(matrix: &mut [f64], width: usize, i: usize, j: usize, c: f64, s: f64) {
    if width == 0 {
        return;
    }
    let (low, high) = (i.min(j), i.max(j));
    let (before, after) = matrix.split_at_mut(high * width);
    let (low_row, high_row) = (&mut before[low * width..][..width], &mut after[..width]);
    // seen from the lower row, the rotation of exchanged rows has the opposite angle
    let s = if i < j { s } else { -s };
    for (one, other) in low_row.iter_mut().zip(high_row) {
        let (x, z) = (*one, *other);
        *one = multiply_add::<FUSED>(c, x, s * z);
        *other = multiply_add::<FUSED>(c, z, -s * x);
    }
}

#[inline(always)]
fn dot<const FUSED: bool>(left: &[f64], right: &[f64]) -> f64 {
    let (l, r) = (left.chunks_exact(LANES), right.chunks_exact(LANES));
    let rest = l.remainder().iter().zip(r.remainder());
    let rest: f64 = rest.map(|(a, b)| a * b).sum();
    let mut sums = [0.0; LANES];
    for (l, r) in l.zip(r) {
        for lane in 0..LANES {
            sums[lane] = multiply_add::<FUSED>(l[lane], r[lane], sums[lane]);
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[inline(always)]
fn add_scaled<const FUSED: bool>(target: &mut [f64], weight: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t = multiply_add::<FUSED>(weight, *s, *t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn product(left: &[f64], right: &[f64], inner: usize) -> Vec<f64> {
        let (rows, columns) = (left.len() / inner, right.len() / inner);
        let entry = |i: usize, j: usize| {
            (0..inner)
                .map(|k| left[i * inner + k] * right[k * columns + j])
                .sum::<f64>()
        };
        (0..rows * columns)
            .map(|index| entry(index / columns, index % columns))
            .collect()
    }

    fn identity(n: usize) -> Vec<f64> {
        (0..n * n)
            .map(|i| f64::from(u8::from(i / n == i % n)))
            .collect()
    }

    fn check(matrix: &[f64], n: usize) {
        let Decomposition {
            values,
            right,
            left,
        } = decompose(matrix, n, &identity(n));
        assert!(values.windows(2).all(|pair| pair[0] >= pair[1]) && values[n - 1] >= 0.0);
        let scaled: Vec<f64> = (0..n * n).map(|i| values[i / n] * right[i]).collect();
        let transposed = |m: &[f64]| (0..n * n).map(|i| m[i % n * n + i / n]).collect::<Vec<_>>();
        let size = 1.0_f64.max(values[0]);
        let close = |left: &[f64], right: &[f64], size: f64| {
            let largest = left
                .iter()
                .zip(right)
                .fold(0.0_f64, |m, (l, r)| m.max((l - r).abs()));
            // rounding of a few times n rotations
            assert!(largest < 1e-14 * n as f64 * size, "{n}: {largest}");
        };
        close(&product(&transposed(&left), &scaled, n), matrix, size);
        close(&product(&right, &transposed(&right), n), &identity(n), 1.0);
        close(&product(&left, &transposed(&left), n), &identity(n), 1.0);
    }

    proptest! {
        /// Graded rows and columns, zero rows and columns, and repeated rows.
        #[test]
        fn factors_are_orthogonal_and_give_the_matrix(
            n in 1_usize..24,
            entries in prop::collection::vec(-1.0..1.0_f64, 24 * 24),
            powers in prop::collection::vec(-9_i32..3, 48),
            zeros in prop::collection::vec(0_u8..8, 48),
        ) {
            let scale = |i: usize| if zeros[i] == 0 { 0.0 } else { 10.0_f64.powi(powers[i] / 3) };
            let source = |i: usize| if zeros[i] == 1 { 0 } else { i };
            let matrix: Vec<f64> = (0..n * n)
                .map(|at| (at / n, at % n))
                .map(|(i, j)| scale(i) * scale(24 + j) * entries[source(i) * 24 + j])
                .collect();
            check(&matrix, n);
        }
    }

    /// Bidiagonal matrices with zeros on the diagonal take the branch that clears a row.
    #[test]
    fn zeros_on_the_diagonal_are_singular_values() {
        for zero in 0..5 {
            let mut matrix = vec![0.0; 25];
            for i in 0..5 {
                matrix[i * 5 + i] = if i == zero { 0.0 } else { 1.0 + i as f64 };
                if i < 4 {
                    matrix[i * 5 + i + 1] = 1.0;
                }
            }
            check(&matrix, 5);
            assert!(decompose(&matrix, 5, &[]).values[4] < 1e-15);
        }
    }

    #[test]
    fn solution_has_the_least_norm() {
        // x + y = 2 and a zero row: the shortest solution is (1, 1)
        let x = solve(&[1.0, 1.0, 0.0, 0.0], 2, &[2.0, 5.0], 1e-12);
        assert!((x[0] - 1.0).abs() < 1e-15 && (x[1] - 1.0).abs() < 1e-15);
    }
}
