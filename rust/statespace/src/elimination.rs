//! Least squares with many unknowns that only a stretch of the rows has.
//!
//! For [Z; I] z = [y; 0] the normal matrix G = Z'Z + I has an envelope: below it are zeros, and the
//! Cholesky factor keeps them. Of its inverse only what lies in the envelope is ever asked for, and
//! that follows from the factor by a recursion that stays in the envelope as well (Erisman and
//! Tinney, Communications of the ACM 18, 1975). All are kept as bands, row by row, which the
//! processor's caches hold where whole matrices would not fit.

use crate::products::multiply_add;

/// Rows whose products are added at once.
const TOGETHER: usize = 4;

/// What is left of some right-hand sides without the unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Eliminated {
    /// G^-1 Z' Y, (unknowns, sides).
    pub found: Vec<f64>,
    /// Y - Z G^-1 Z' Y, (rows, sides).
    pub left: Vec<f64>,
    /// Diagonal of Z G^-1 Z', (rows,); empty where it was not asked for.
    pub leverage: Vec<f64>,
}

/// Eliminates the unknowns of `z`, (rows, unknowns), from `y`, (rows, sides).
///
/// `None` where an entry is not finite.
pub fn eliminate(
    z: &[f64],
    y: &[f64],
    unknowns: usize,
    sides: usize,
    leverage: bool,
) -> Option<Eliminated> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has just said that it has both.
        return unsafe { eliminate_avx2(z, y, unknowns, sides, leverage) };
    }
    eliminated::<false>(z, y, unknowns, sides, leverage)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn eliminate_avx2(
    z: &[f64],
    y: &[f64],
    unknowns: usize,
    sides: usize,
    leverage: bool,
) -> Option<Eliminated> {
    eliminated::<true>(z, y, unknowns, sides, leverage)
}

#[inline(always)]
fn eliminated<const FUSED: bool>(
    z: &[f64],
    y: &[f64],
    unknowns: usize,
    sides: usize,
    leverage: bool,
) -> Option<Eliminated> {
    let n = unknowns;
    let rows: Vec<(usize, &[f64])> = z.chunks_exact(n).map(used).collect();
    let first = envelope(&rows, n);
    let factor = factorised::<FUSED>(&rows, z, &first)?;
    let mut found = vec![0.0; n * sides];
    for ((start, row), y) in rows.iter().zip(y.chunks_exact(sides)) {
        for (i, &value) in row.iter().enumerate() {
            add_scaled::<FUSED>(&mut found[(start + i) * sides..][..sides], value, y);
        }
    }
    substitute::<FUSED>(&factor, &first, &mut found, sides);
    let mut left = y.to_vec();
    for ((start, row), left) in rows.iter().zip(left.chunks_exact_mut(sides)) {
        for (i, &value) in row.iter().enumerate() {
            add_scaled::<FUSED>(left, -value, &found[(start + i) * sides..][..sides]);
        }
    }
    let leverage = if leverage {
        leverages::<FUSED>(&rows, &inverse_within::<FUSED>(&factor, &first))
    } else {
        Vec::new()
    };
    Some(Eliminated {
        found,
        left,
        leverage,
    })
}

/// A square matrix of which only a band is kept, row by row.
struct Band {
    /// Entries of a row left of the diagonal.
    left: usize,
    /// Entries of a row in all.
    width: usize,
    entries: Vec<f64>,
}

impl Band {
    /// Zeros: of `n` rows, so many entries left and right of the diagonal.
    fn new(n: usize, left: usize, right: usize) -> Self {
        let width = left + 1 + right;
        Self {
            left,
            width,
            entries: vec![0.0; n * width],
        }
    }

    /// Where an entry is; it must lie within the band.
    #[inline(always)]
    fn place(&self, row: usize, column: usize) -> usize {
        row * self.width + column + self.left - row
    }

    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[self.place(row, column)]
    }

    /// Neighbours in a row, from one column to before another.
    #[inline(always)]
    fn row(&self, row: usize, from: usize, to: usize) -> &[f64] {
        &self.entries[self.place(row, from)..][..to - from]
    }

    #[inline(always)]
    fn row_mut(&mut self, row: usize, from: usize, to: usize) -> &mut [f64] {
        let place = self.place(row, from);
        &mut self.entries[place..][..to - from]
    }

    #[inline(always)]
    fn set(&mut self, row: usize, column: usize, value: f64) {
        let place = self.place(row, column);
        self.entries[place] = value;
    }
}

/// Lower Cholesky factor of G.
#[inline(always)]
fn factorised<const FUSED: bool>(
    rows: &[(usize, &[f64])],
    z: &[f64],
    first: &[usize],
) -> Option<Band> {
    let n = first.len();
    let left = (0..n).map(|i| i - first[i]).max().unwrap_or(0);
    let mut factor = Band::new(n, left, 0);
    for (number, rows) in rows.chunks(TOGETHER).enumerate() {
        let first = number * TOGETHER * n;
        add_products::<FUSED>(&mut factor, rows, &z[first..][..rows.len() * n], n);
    }
    decompose::<FUSED>(&mut factor, first)?;
    Some(factor)
}

/// What is left of unit errors in successive blocks of rows: I - Z_b G^-1 Z_b' of each block.
///
/// `stops` are the rows behind the blocks' last ones. `None` where an entry is not finite.
pub fn remainders(z: &[f64], unknowns: usize, stops: &[usize]) -> Option<Vec<Vec<f64>>> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has just said that it has both.
        return unsafe { remainders_avx2(z, unknowns, stops) };
    }
    remaining::<false>(z, unknowns, stops)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn remainders_avx2(z: &[f64], unknowns: usize, stops: &[usize]) -> Option<Vec<Vec<f64>>> {
    remaining::<true>(z, unknowns, stops)
}

#[inline(always)]
fn remaining<const FUSED: bool>(
    z: &[f64],
    unknowns: usize,
    stops: &[usize],
) -> Option<Vec<Vec<f64>>> {
    let rows: Vec<(usize, &[f64])> = z.chunks_exact(unknowns).map(used).collect();
    let first = envelope(&rows, unknowns);
    let factor = factorised::<FUSED>(&rows, z, &first)?;
    let mut found = Vec::with_capacity(stops.len());
    let mut start = 0;
    for &stop in stops {
        found.push(remainder::<FUSED>(&rows[start..stop], &factor, &first));
        start = stop;
    }
    Some(found)
}

/// I - V'V of some rows, V = L^-1 Z_b'.
#[inline(always)]
fn remainder<const FUSED: bool>(
    rows: &[(usize, &[f64])],
    factor: &Band,
    first: &[usize],
) -> Vec<f64> {
    let (n, count) = (first.len(), rows.len());
    let mut solved = vec![0.0; n * count];
    for (k, &(start, row)) in rows.iter().enumerate() {
        for (i, &value) in row.iter().enumerate() {
            solved[(start + i) * count + k] = value;
        }
    }
    let begin = rows.iter().map(|(start, _)| *start).min().unwrap_or(n);
    let mut left = vec![0.0; count * count];
    left.iter_mut()
        .step_by(count + 1)
        .for_each(|own| *own = 1.0);
    for i in begin..n {
        let (above, row) = solved.split_at_mut(i * count);
        let row = &mut row[..count];
        for j in first[i].max(begin)..i {
            add_scaled::<FUSED>(row, -factor.at(i, j), &above[j * count..][..count]);
        }
        row.iter_mut().for_each(|v| *v /= factor.at(i, i));
        for (k, left) in left.chunks_exact_mut(count).enumerate() {
            add_scaled::<FUSED>(left, -row[k], row);
        }
    }
    left
}

/// Adds to the lower half of a matrix what some neighbouring rows add to Z'Z.
///
/// Neighbours have nearly the same unknowns, and four at once halve the traffic with the matrix.
#[inline(always)]
fn add_products<const FUSED: bool>(
    matrix: &mut Band,
    used: &[(usize, &[f64])],
    rows: &[f64],
    n: usize,
) {
    let start = used.iter().map(|(start, _)| *start).min().unwrap_or(0);
    let stop = used.iter().map(|(start, row)| start + row.len()).max();
    for i in start..stop.unwrap_or(0) {
        // no row has two unknowns that are further apart than the band is wide
        let from = start.max(i.saturating_sub(matrix.left));
        let target = matrix.row_mut(i, from, i + 1);
        if rows.len() == TOGETHER * n {
            let four: [&[f64]; TOGETHER] = std::array::from_fn(|k| &rows[k * n..][..n]);
            add_four::<FUSED>(
                target,
                four.map(|row| row[i]),
                four.map(|row| &row[from..=i]),
            );
        } else {
            for row in rows.chunks_exact(n) {
                add_scaled::<FUSED>(target, row[i], &row[from..=i]);
            }
        }
    }
}

/// z' S z of each row, by the lower half of S.
#[inline(always)]
fn leverages<const FUSED: bool>(rows: &[(usize, &[f64])], inverse: &Band) -> Vec<f64> {
    let mut found = Vec::with_capacity(rows.len());
    // no closure: one would be compiled for any processor, and each fused product be a call
    for &(start, row) in rows {
        let mut sum = 0.0;
        for (i, &value) in row.iter().enumerate() {
            let entries = inverse.row(start + i, start, start + i + 1);
            let below = dot::<FUSED>(&entries[..i], &row[..i]);
            sum += value * (2.0 * below + entries[i] * value);
        }
        found.push(sum);
    }
    found
}

/// A row from its first entry that is not zero to its last, and where that begins.
fn used(row: &[f64]) -> (usize, &[f64]) {
    let start = row.iter().position(|&v| v != 0.0).unwrap_or(0);
    let stop = row
        .iter()
        .rposition(|&v| v != 0.0)
        .map_or(start, |last| last + 1);
    (start, &row[start..stop])
}

/// For each unknown the first one it meets in some row; never falling.
fn envelope(rows: &[(usize, &[f64])], n: usize) -> Vec<usize> {
    let mut first: Vec<usize> = (0..n).collect();
    for &(start, row) in rows {
        if let Some(last) = row.len().checked_sub(1) {
            first[start + last] = first[start + last].min(start);
        }
    }
    for i in (1..n).rev() {
        first[i - 1] = first[i - 1].min(first[i]);
    }
    first
}

/// Lower Cholesky factor of G, whose Z'Z stands in `matrix`.
#[inline(always)]
fn decompose<const FUSED: bool>(matrix: &mut Band, first: &[usize]) -> Option<()> {
    for i in 0..first.len() {
        for j in first[i]..i {
            let from = first[i].max(first[j]);
            let shared = dot::<FUSED>(matrix.row(i, from, j), matrix.row(j, from, j));
            let entry = (matrix.at(i, j) - shared) / matrix.at(j, j);
            matrix.set(i, j, entry);
        }
        let own = matrix.row(i, first[i], i);
        let pivot = 1.0 + matrix.at(i, i) - dot::<FUSED>(own, own);
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        matrix.set(i, i, pivot.sqrt());
    }
    Some(())
}

/// G^-1 times several right-hand sides, in place.
#[inline(always)]
fn substitute<const FUSED: bool>(factor: &Band, first: &[usize], right: &mut [f64], sides: usize) {
    let n = first.len();
    for i in 0..n {
        let (above, row) = right.split_at_mut(i * sides);
        for j in first[i]..i {
            add_scaled::<FUSED>(
                &mut row[..sides],
                -factor.at(i, j),
                &above[j * sides..][..sides],
            );
        }
        row[..sides].iter_mut().for_each(|v| *v /= factor.at(i, i));
    }
    for i in (0..n).rev() {
        let (above, row) = right.split_at_mut(i * sides);
        row[..sides].iter_mut().for_each(|v| *v /= factor.at(i, i));
        for j in first[i]..i {
            add_scaled::<FUSED>(
                &mut above[j * sides..][..sides],
                -factor.at(i, j),
                &row[..sides],
            );
        }
    }
}

/// Entries of G^-1 within the envelope and its mirror image; zeros elsewhere.
///
/// S_ij = (d_ij / L_ii - sum over k > i of L_ki S_kj) / L_ii, from the last row up.
#[inline(always)]
fn inverse_within<const FUSED: bool>(factor: &Band, first: &[usize]) -> Band {
    let n = first.len();
    let mut inverse = Band::new(n, factor.left, factor.left);
    let mut weights = Vec::with_capacity(factor.left);
    let mut row = Vec::with_capacity(factor.left);
    let mut stop = n; // of the rows that meet unknown i
    for i in (0..n).rev() {
        while stop > i + 1 && first[stop - 1] > i {
            stop -= 1;
        }
        let pivot = factor.at(i, i);
        weights.clear();
        for k in i + 1..stop {
            weights.push(-factor.at(k, i) / pivot);
        }
        row.clear();
        row.resize(weights.len(), 0.0);
        let mut k = i + 1;
        for four in weights.chunks(TOGETHER) {
            let sources = |c: usize| inverse.row(k + c, i + 1, stop);
            if let &[a, b, c, d] = four {
                let sources = [sources(0), sources(1), sources(2), sources(3)];
                add_four::<FUSED>(&mut row, [a, b, c, d], sources);
            } else {
                for (c, &weight) in four.iter().enumerate() {
                    add_scaled::<FUSED>(&mut row, weight, sources(c));
                }
            }
            k += four.len();
        }
        let own = 1.0 / (pivot * pivot) + dot::<FUSED>(&weights, &row);
        inverse.set(i, i, own);
        inverse.row_mut(i, i + 1, stop).copy_from_slice(&row);
        for (k, &entry) in (i + 1..stop).zip(&row) {
            inverse.set(k, i, entry);
        }
    }
    inverse
}

/// Adds four weighted lists at once: a fourth of the traffic with the sum.
#[inline(always)]
fn add_four<const FUSED: bool>(
    target: &mut [f64],
    weights: [f64; TOGETHER],
    sources: [&[f64]; TOGETHER],
) {
    let [a, b, c, d] = sources;
    let pairs = a.iter().zip(b).zip(c.iter().zip(d));
    for (t, ((a, b), (c, d))) in target.iter_mut().zip(pairs) {
        let two = multiply_add::<FUSED>(weights[1], *b, multiply_add::<FUSED>(weights[0], *a, *t));
        *t = multiply_add::<FUSED>(weights[3], *d, multiply_add::<FUSED>(weights[2], *c, two));
    }
}

#[inline(always)]
fn add_scaled<const FUSED: bool>(target: &mut [f64], weight: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t = multiply_add::<FUSED>(weight, *s, *t);
    }
}

#[inline(always)]
fn dot<const FUSED: bool>(left: &[f64], right: &[f64]) -> f64 {
    const LANES: usize = 4;
    const AT_ONCE: usize = 4 * LANES; // sums enough that none waits for itself
    let (l, r) = (left.chunks_exact(AT_ONCE), right.chunks_exact(AT_ONCE));
    let ends = (l.remainder(), r.remainder());
    let mut sums = [[0.0; LANES]; 4];
    for (l, r) in l.zip(r) {
        for (part, sums) in sums.iter_mut().enumerate() {
            for lane in 0..LANES {
                let i = part * LANES + lane;
                sums[lane] = multiply_add::<FUSED>(l[i], r[i], sums[lane]);
            }
        }
    }
    let mut sum: [f64; LANES] =
        std::array::from_fn(|i| (sums[0][i] + sums[1][i]) + (sums[2][i] + sums[3][i]));
    let (l, r) = (ends.0.chunks_exact(LANES), ends.1.chunks_exact(LANES));
    let ends = l.remainder().iter().zip(r.remainder());
    for (l, r) in l.zip(r) {
        for lane in 0..LANES {
            sum[lane] = multiply_add::<FUSED>(l[lane], r[lane], sum[lane]);
        }
    }
    let rest: f64 = ends.map(|(a, b)| a * b).sum();
    (sum[0] + sum[1]) + (sum[2] + sum[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows that have a few unknowns each, one that has none, and unknowns that no row has.
    fn example() -> (Vec<f64>, Vec<f64>, usize, usize) {
        let (rows, n, sides) = (42, 23, 3); // two rows more than whole groups of four
        let mut z = vec![0.0; rows * n];
        for row in 0..rows {
            if row == 7 {
                continue;
            }
            for i in row / 2..(row / 2 + 5 + row % 4).min(n - 2) {
                z[row * n + i] = f64::from(u32::try_from((row * 31 + i * 17) % 29).unwrap()) - 14.0;
            }
        }
        let y = (0..rows * sides)
            .map(|i| f64::from(i as u32 * 37 % 101) - 50.0)
            .collect();
        (z, y, n, sides)
    }

    #[test]
    fn solves_the_normal_equations() {
        let (z, y, n, sides) = example();
        let found = eliminate(&z, &y, n, sides, false).unwrap();
        for j in 0..sides {
            let column =
                |m: &[f64]| -> Vec<f64> { m.iter().skip(j).step_by(sides).copied().collect() };
            let (x, left) = (column(&found.found), column(&found.left));
            for i in 0..n {
                // G x = Z'y is Z'(y - Z x) = x.
                let seen: f64 = (0..left.len()).map(|row| z[row * n + i] * left[row]).sum();
                assert!((seen - x[i]).abs() < 1e-9, "{seen} {}", x[i]);
            }
        }
    }

    #[test]
    fn leverage_is_what_a_unit_error_leaves_of_itself() {
        let (z, _, n, _) = example();
        let rows = z.len() / n;
        for row in [0, 7, 20, rows - 1] {
            let mut unit = vec![0.0; rows];
            unit[row] = 1.0;
            let found = eliminate(&z, &unit, n, 1, true).unwrap();
            assert!((found.left[row] - (1.0 - found.leverage[row])).abs() < 1e-12);
        }
    }

    #[test]
    fn remainders_are_what_is_left_of_unit_errors() {
        let (z, _, n, _) = example();
        let rows = z.len() / n;
        let (start, stop) = (5, 12); // row 7 has no unknown
        let blocks = remainders(&z, n, &[start, stop, rows]).unwrap();
        let count = stop - start;
        let mut units = vec![0.0; rows * count];
        for k in 0..count {
            units[(start + k) * count + k] = 1.0;
        }
        let found = eliminate(&z, &units, n, count, false).unwrap();
        let expected = &found.left[start * count..stop * count];
        for (a, b) in blocks[1].iter().zip(expected) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn plain_and_fused_agree() {
        let (z, y, n, sides) = example();
        let (plain, best) = (
            eliminated::<false>(&z, &y, n, sides, true),
            eliminate(&z, &y, n, sides, true),
        );
        for (a, b) in plain.unwrap().left.iter().zip(best.unwrap().left) {
            assert!((a - b).abs() < 1e-10);
        }
    }

    #[test]
    fn refuses_what_is_not_finite() {
        assert_eq!(eliminate(&[1.0, f64::NAN], &[1.0], 2, 1, true), None);
    }
}
