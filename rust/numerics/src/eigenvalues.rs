//! Eigenvalues of many small matrices of one size, side by side in vectors.
//!
//! The steps are those of LAPACK's `dgeev` without vectors: balancing, reduction to Hessenberg form
//! by reflections, and the QR algorithm with implicit double shifts (Golub and Van Loan, Matrix
//! Computations, 7.5). Matrices whose iterations converge at different rates wait for each other.

use std::sync::atomic::{Ordering, compiler_fence};

use crate::products::{multiply_add, with_vectors};

/// Matrices side by side.
const LANES: usize = 8;
/// Largest number of iterations over the size of the matrix.
const MAX_ITERATIONS: usize = 30;
/// Iterations for an eigenvalue after which a shift is exceptional.
const EXCEPTIONAL_SHIFT_EVERY: usize = 10;
/// Share of the largest entry below which entries left of the diagonal are zero: squares of the
/// others do not underflow.
const NEGLIGIBLE_SHARE: f64 = f64::EPSILON * f64::EPSILON;
/// Real part from a diagonal entry, and imaginary part, of an exceptional shift, over the sum of
/// two entries below the diagonal; as in LAPACK.
const EXCEPTIONAL_SHIFT: [f64; 2] = [0.75, 0.6614378277661477];
/// Sum of the norms of a row and its column, over the last one, below which balancing continues.
const MIN_NORM_DECREASE: f64 = 0.95;

/// The same entry of all matrices.
type Lanes = [f64; LANES];

/// Eigenvalues (count, n) as pairs of real and imaginary part, of matrices (count, n, n).
///
/// The order of the eigenvalues is not defined. Returns `None` if an iteration does not converge,
/// as those of a matrix with an entry that is not finite.
pub fn eigenvalues(matrices: &[f64], n: usize) -> Option<Vec<[f64; 2]>> {
    assert!(n > 0 && matrices.len().is_multiple_of(n * n));
    with_vectors!(each_group(matrices: &[f64], n: usize) -> Option<Vec<[f64; 2]>>)
}

#[inline(always)]
fn each_group<const FUSED: bool>(matrices: &[f64], n: usize) -> Option<Vec<[f64; 2]>> {
    let mut values = vec![[0.0; 2]; matrices.len() / n];
    let mut group = Group::new(n);
    let groups = matrices.chunks(LANES * n * n);
    for (matrices, values) in groups.zip(values.chunks_mut(LANES * n)) {
        group.load(matrices);
        group.balance();
        group.reduce::<FUSED>();
        group.iterate::<FUSED>(values)?;
    }
    let is_finite = values.as_flattened().iter().all(|each| each.is_finite());
    is_finite.then_some(values)
}

/// Matrices side by side, row by row.
struct Group {
    n: usize,
    /// Entries from a row to the next, after a column of zeros: odd, because rows at distances of
    /// powers of two would share the same places of a cache.
    stride: usize,
    /// Rows, and a row of zeros: reflections of three rows may reach beyond the last one.
    entries: Vec<Lanes>,
}

/// Rows that an iteration of one matrix changes.
#[derive(Clone, Copy, Default)]
struct Window {
    /// First row.
    low: usize,
    /// Last row; the matrix waits if it is the first.
    high: usize,
    /// Real and imaginary parts of both shifts.
    shifts: [[f64; 2]; 2],
}

impl Group {
    fn new(n: usize) -> Self {
        let stride = (n + 1) | 1;
        let entries = vec![[0.0; LANES]; (n + 1) * stride];
        Self { n, stride, entries }
    }

    /// Replaces the matrices; the last one also fills the remaining lanes.
    fn load(&mut self, matrices: &[f64]) {
        let size = self.n * self.n;
        let last = matrices.len() / size - 1;
        for i in 0..self.n {
            for j in 0..self.n {
                let place = i * self.n + j;
                self.entries[i * self.stride + j] =
                    std::array::from_fn(|lane| matrices[lane.min(last) * size + place]);
            }
        }
    }

    #[inline(always)]
    fn at(&self, i: usize, j: usize) -> Lanes {
        self.entries[i * self.stride + j]
    }

    #[inline(always)]
    fn at_mut(&mut self, i: usize, j: usize) -> &mut Lanes {
        &mut self.entries[i * self.stride + j]
    }

    /// Scales rows and columns by powers of two until their norms differ by little.
    #[inline(always)]
    fn balance(&mut self) {
        let mut is_balanced = false;
        while !is_balanced {
            is_balanced = true;
            for i in 0..self.n {
                let (mut row, mut column) = ([0.0; LANES], [0.0; LANES]);
                for j in (0..self.n).filter(|&j| j != i) {
                    let (right, below) = (self.at(i, j), self.at(j, i));
                    for lane in 0..LANES {
                        row[lane] += right[lane].abs();
                        column[lane] += below[lane].abs();
                    }
                }
                let scale = std::array::from_fn(|lane| balancing(row[lane], column[lane]));
                if scale == [1.0; LANES] {
                    continue;
                }
                is_balanced = false;
                for j in (0..self.n).filter(|&j| j != i) {
                    let (right, below) = (self.at(i, j), self.at(j, i));
                    *self.at_mut(i, j) = std::array::from_fn(|lane| right[lane] / scale[lane]);
                    *self.at_mut(j, i) = std::array::from_fn(|lane| below[lane] * scale[lane]);
                }
            }
        }
    }

    /// Reduces the matrices to Hessenberg form; entries below the subdiagonal become zero.
    #[inline(always)]
    fn reduce<const FUSED: bool>(&mut self) {
        let n = self.n;
        let mut vector = vec![[0.0; LANES]; n];
        let mut sums = vec![[0.0; LANES]; n];
        for k in 0..n.saturating_sub(2) {
            // the reflection of column k below the diagonal
            let below = k + 1..n;
            let mut tail = [0.0; LANES];
            for i in k + 2..n {
                vector[i] = self.at(i, k);
                tail = plus_product::<FUSED>(tail, vector[i], vector[i]);
                *self.at_mut(i, k) = [0.0; LANES];
            }
            let reflection = Reflection::of(self.at(k + 1, k), tail);
            *self.at_mut(k + 1, k) = reflection.image;
            vector[k + 1] = [1.0; LANES];
            for i in k + 2..n {
                vector[i] = product(vector[i], reflection.scale);
            }
            // from the left: v' H first, then row by row with the reflection from the right
            sums[below.clone()].fill([0.0; LANES]);
            for i in below.clone() {
                let row = &self.entries[i * self.stride..][below.clone()];
                for (sum, &entry) in sums[below.clone()].iter_mut().zip(row) {
                    add_product::<FUSED>(sum, vector[i], entry);
                }
            }
            let factor = reflection.factor;
            for i in 0..n {
                let row = &mut self.entries[i * self.stride..][below.clone()];
                let mut onto = [0.0; LANES];
                if i > k {
                    let weight = negative(product(vector[i], factor));
                    for ((entry, &sum), &v) in row
                        .iter_mut()
                        .zip(&sums[below.clone()])
                        .zip(&vector[below.clone()])
                    {
                        add_product::<FUSED>(entry, weight, sum);
                        onto = plus_product::<FUSED>(onto, *entry, v);
                    }
                } else {
                    for (&entry, &v) in row.iter().zip(&vector[below.clone()]) {
                        onto = plus_product::<FUSED>(onto, entry, v);
                    }
                }
                let weight = negative(product(onto, factor));
                for (entry, &v) in row.iter_mut().zip(&vector[below.clone()]) {
                    add_product::<FUSED>(entry, weight, v);
                }
            }
        }
    }

    /// Computes the eigenvalues of matrices in Hessenberg form, from the last row to the first.
    #[inline(always)]
    fn iterate<const FUSED: bool>(&mut self, values: &mut [[f64; 2]]) -> Option<()> {
        let mut largest = [0.0; LANES];
        for entry in &self.entries {
            for lane in 0..LANES {
                largest[lane] = f64::max(largest[lane], entry[lane].abs());
            }
        }
        let negligible = largest.map(|entry| NEGLIGIBLE_SHARE * entry);
        let mut remaining = [self.n; LANES];
        let mut iterations = [0; LANES]; // for an eigenvalue
        // values of the lanes that repeat the last matrix are not needed
        remaining[values.len() / self.n..].fill(0);
        for _ in 0..=MAX_ITERATIONS * self.n.max(10) {
            let mut windows = [Window::default(); LANES];
            for lane in 0..LANES {
                while remaining[lane] > 0 {
                    let high = remaining[lane] - 1;
                    let low = self.first_of_block(high, negligible[lane], lane);
                    if low + 1 < high {
                        iterations[lane] += 1;
                        let shifts = self.shifts(low, high, iterations[lane], lane);
                        windows[lane] = Window { low, high, shifts };
                        break;
                    }
                    let values = &mut values[lane * self.n..];
                    if low == high {
                        values[high] = [self.at(high, high)[lane], 0.0];
                    } else {
                        let pair = self.pair(low, lane);
                        values[low..=high].copy_from_slice(&pair);
                    }
                    remaining[lane] = low;
                    iterations[lane] = 0;
                }
            }
            if remaining == [0; LANES] {
                return Some(());
            }
            self.sweep::<FUSED>(&windows);
        }
        None
    }

    /// First row of the last block up to a row; the entry left of its diagonal becomes zero.
    ///
    /// The criterion is that of Ahues and Tisseur (LAPACK Working Note 122).
    #[inline(always)]
    fn first_of_block(&mut self, high: usize, negligible: f64, lane: usize) -> usize {
        for k in (1..=high).rev() {
            let below = self.at(k, k - 1)[lane].abs();
            let (before, after) = (self.at(k - 1, k - 1)[lane], self.at(k, k)[lane]);
            if below > negligible.max(f64::EPSILON * (before.abs() + after.abs())) {
                continue;
            }
            let above = self.at(k - 1, k)[lane].abs();
            let (large, small) = (below.max(above), below.min(above));
            let difference = (before - after).abs();
            let (far, near) = (after.abs().max(difference), after.abs().min(difference));
            let sum = far + large;
            let limit = f64::EPSILON * (near * (far / sum));
            if below <= negligible || small * (large / sum) <= limit {
                self.at_mut(k, k - 1)[lane] = 0.0;
                return k;
            }
        }
        0
    }

    /// Eigenvalues of the last two rows of a block, or twice its real eigenvalue that is closer to
    /// the last entry; sometimes other numbers, which break cycles.
    #[inline(always)]
    fn shifts(&self, low: usize, high: usize, iteration: usize, lane: usize) -> [[f64; 2]; 2] {
        if iteration.is_multiple_of(EXCEPTIONAL_SHIFT_EVERY) {
            let is_at_end = iteration.is_multiple_of(2 * EXCEPTIONAL_SHIFT_EVERY);
            let (corner, last) = if is_at_end {
                (high, high)
            } else {
                (low, low + 2)
            };
            let below = |k: usize| self.at(k, k - 1)[lane].abs();
            let size = below(last) + below(last - 1);
            let middle = self.at(corner, corner)[lane] + EXCEPTIONAL_SHIFT[0] * size;
            return [1.0, -1.0].map(|sign| [middle, sign * EXCEPTIONAL_SHIFT[1] * size]);
        }
        let pair = self.pair(high - 1, lane);
        let [[first, imaginary], [second, _]] = pair;
        let last = self.at(high, high)[lane];
        match imaginary {
            0.0 if (first - last).abs() < (second - last).abs() => [[first, 0.0]; 2],
            0.0 => [[second, 0.0]; 2],
            _ => pair,
        }
    }

    /// Eigenvalues of the block of two rows from row k on.
    #[inline(always)]
    fn pair(&self, k: usize, lane: usize) -> [[f64; 2]; 2] {
        let entry = |i: usize, j: usize| self.at(k + i, k + j)[lane];
        let last = entry(1, 1);
        let half = 0.5 * (entry(0, 0) - last);
        let squared = entry(0, 1) * entry(1, 0);
        let discriminant = half * half + squared;
        if discriminant < 0.0 {
            let imaginary = (-discriminant).sqrt();
            return [imaginary, -imaginary].map(|im| [last + half, im]);
        }
        let far = half + discriminant.sqrt().copysign(half);
        let near = if far == 0.0 { 0.0 } else { squared / far };
        [[last + far, 0.0], [last - near, 0.0]]
    }

    /// First column of (H - a) (H - b) from row k on, over the entry below its diagonal.
    #[inline(always)]
    fn first_column(&self, k: usize, shifts: [[f64; 2]; 2], lane: usize) -> [f64; 3] {
        let entry = |i: usize, j: usize| self.at(k + i, k + j)[lane];
        // differences first: shifts are close to entries
        let [(a, im_a), (b, im_b)] = shifts.map(|[re, im]| (entry(0, 0) - re, im));
        let first = (a * b - im_a * im_b) / entry(1, 0) + entry(0, 1);
        [first, a + (entry(1, 1) - shifts[1][0]), entry(2, 1)]
    }

    /// An iteration with two shifts of each matrix, within its window.
    #[inline(always)]
    fn sweep<const FUSED: bool>(&mut self, windows: &[Window; LANES]) {
        let iterating = || windows.iter().filter(|window| window.high > window.low);
        let begin = iterating().map(|window| window.low).min().unwrap_or(0);
        let end = iterating().map(|window| window.high).max().unwrap_or(0);
        for k in begin..end {
            let is_inside = windows.map(|each| each.low < k && k < each.high);
            let is_first = windows.map(|each| each.low == k && k < each.high);
            let has_three = windows.map(|each| k + 1 < each.high);
            // the vector of the reflection: of the shifts, or what they left below the diagonal
            let zero = [0.0; LANES];
            let third = |entry: Lanes| select(has_three, entry, zero);
            let mut vector = [zero; 3];
            if k > 0 {
                vector[0] = select(is_inside, self.at(k, k - 1), zero);
                vector[1] = select(is_inside, self.at(k + 1, k - 1), zero);
                vector[2] = third(select(is_inside, self.at(k + 2, k - 1), zero));
            }
            for lane in (0..LANES).filter(|&lane| is_first[lane]) {
                let column = self.first_column(k, windows[lane].shifts, lane);
                let size = column.iter().fold(0.0, |size: f64, each| size + each.abs());
                for (row, each) in vector.iter_mut().zip(column) {
                    row[lane] = each / size;
                }
            }
            let tail = product(vector[1], vector[1]);
            let tail = plus_product::<FUSED>(tail, vector[2], vector[2]);
            let reflection = Reflection::of(vector[0], tail);
            if k > 0 {
                for (i, value) in [(k, reflection.image), (k + 1, zero), (k + 2, zero)] {
                    *self.at_mut(i, k - 1) = select(is_inside, value, self.at(i, k - 1));
                }
            }
            let scale = reflection.scale;
            let v = [
                [1.0; LANES],
                product(vector[1], scale),
                product(vector[2], scale),
            ];
            let w = v.map(|each| product(each, reflection.factor));
            self.reflect::<FUSED>(k, begin, end, v, w);
        }
    }

    /// Reflects three rows and columns from k on: x - (x . w) v.
    #[inline(always)]
    fn reflect<const FUSED: bool>(
        &mut self,
        k: usize,
        begin: usize,
        end: usize,
        v: [Lanes; 3],
        w: [Lanes; 3],
    ) {
        let rows = &mut self.entries[k * self.stride..][..3 * self.stride];
        let (first, others) = rows.split_at_mut(self.stride);
        let (second, third) = others.split_at_mut(self.stride);
        let columns = first[k..=end]
            .iter_mut()
            .zip(&mut second[k..=end])
            .zip(&mut third[k..=end]);
        for ((a, b), c) in columns {
            reflect::<FUSED>(a, b, c, v, w);
        }
        let rows = self.entries[begin * self.stride..].chunks_mut(self.stride);
        for row in rows.take(end.min(k + 3) + 1 - begin) {
            let [a, b, c] = &mut row[k..k + 3] else {
                unreachable!("three entries")
            };
            reflect::<FUSED>(a, b, c, v, w);
        }
    }
}

/// (a, b, c) - (a, b, c) . w v.
#[inline(always)]
fn reflect<const FUSED: bool>(
    a: &mut Lanes,
    b: &mut Lanes,
    c: &mut Lanes,
    v: [Lanes; 3],
    w: [Lanes; 3],
) {
    let mut onto = [0.0; LANES];
    for lane in 0..LANES {
        let sum = multiply_add::<FUSED>(b[lane], w[1][lane], a[lane] * w[0][lane]);
        onto[lane] = multiply_add::<FUSED>(c[lane], w[2][lane], sum);
    }
    for (x, v) in [a, b, c].into_iter().zip(v) {
        add_product::<FUSED>(x, negative(onto), v);
    }
}

/// Reflection 1 - factor v v' of a vector onto (image, 0, ...); v is one, then scale times the
/// other entries of the vector.
struct Reflection {
    image: Lanes,
    scale: Lanes,
    factor: Lanes,
}

impl Reflection {
    /// The reflection of a vector with a first entry and a sum of squares of the others.
    ///
    /// Without others it is the identity.
    #[inline(always)]
    fn of(first: Lanes, tail: Lanes) -> Self {
        let (mut image, mut scale, mut factor) = (first, [0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let norm = -(first[lane] * first[lane] + tail[lane])
                .sqrt()
                .copysign(first[lane]);
            let is_identity = tail[lane] == 0.0;
            let (over, by) = (1.0 / (first[lane] - norm), (norm - first[lane]) / norm);
            image[lane] = if is_identity { first[lane] } else { norm };
            scale[lane] = if is_identity { 0.0 } else { over };
            factor[lane] = if is_identity { 0.0 } else { by };
        }
        Self {
            image,
            scale,
            factor,
        }
    }
}

/// Power of two by which a column is multiplied and its row divided; one if this gains little.
#[inline(always)]
fn balancing(row: f64, column: f64) -> f64 {
    if row == 0.0 || column == 0.0 {
        return 1.0;
    }
    let exponent = |value: f64| (value.to_bits() >> 52) as i64; // of positive numbers
    let half = (exponent(row) - exponent(column)) >> 1;
    let scale = f64::from_bits(((half + 1023).clamp(1, 2046) as u64) << 52);
    let is_smaller = column * scale + row / scale < MIN_NORM_DECREASE * (column + row);
    if is_smaller { scale } else { 1.0 }
}

#[inline(always)]
fn product(mut a: Lanes, b: Lanes) -> Lanes {
    for lane in 0..LANES {
        a[lane] *= b[lane];
    }
    a
}

#[inline(always)]
fn negative(mut a: Lanes) -> Lanes {
    for lane in 0..LANES {
        a[lane] = -a[lane];
    }
    a
}

/// sum + a b.
#[inline(always)]
fn plus_product<const FUSED: bool>(mut sum: Lanes, a: Lanes, b: Lanes) -> Lanes {
    for lane in 0..LANES {
        sum[lane] = multiply_add::<FUSED>(a[lane], b[lane], sum[lane]);
    }
    sum
}

/// Adds a b to an entry of a matrix.
///
/// The fence, which is no instruction, keeps the compiler from filling registers with lanes of
/// several entries, which takes twice as long.
#[inline(always)]
fn add_product<const FUSED: bool>(entry: &mut Lanes, a: Lanes, b: Lanes) {
    *entry = plus_product::<FUSED>(*entry, a, b);
    compiler_fence(Ordering::SeqCst);
}

#[inline(always)]
fn select(is_first: [bool; LANES], first: Lanes, mut second: Lanes) -> Lanes {
    for lane in 0..LANES {
        if is_first[lane] {
            second[lane] = first[lane];
        }
    }
    second
}

#[cfg(test)]
mod tests;
