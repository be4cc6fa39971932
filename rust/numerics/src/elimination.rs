//! Least squares with many unknowns, each of which occurs in a few successive rows only.
//!
//! For [Z; I] z = [y; 0] the normal matrix G = Z'Z + I has an envelope, outside of which all
//! entries are zero; the Cholesky factor has the same envelope. Only the entries of G^-1 within the
//! envelope are needed. They follow from the factor by a recursion that uses no other entries
//! (Erisman and Tinney, Communications of the ACM 18, 1975). Matrices are stored as bands, row by
//! row: bands fit into the processor's caches, full matrices do not.

use crate::products::multiply_add;

/// Number of rows whose products are added in one pass.
const ROWS_PER_PASS: usize = 4;
/// Rows whose entries are side by side in vectors.
const LANES: usize = 8;

/// Rows of equations with few, adjacent unknowns each.
#[derive(Clone, Copy, Debug)]
pub struct Windows<'a> {
    /// First unknown of the window of each row.
    pub first: &'a [usize],
    /// Entries (rows, width), row-major; zero after the last unknown.
    pub entries: &'a [f64],
    /// Unknowns per window.
    pub width: usize,
    /// Number of unknowns.
    pub unknowns: usize,
}

impl<'a> Windows<'a> {
    /// First unknown and entries of each row, without leading and trailing zeros.
    fn rows(self) -> Vec<Row<'a>> {
        let windows = self.entries.chunks_exact(self.width);
        self.first.iter().zip(windows).map(trim_zeros).collect()
    }

    /// Product of each row with the unknowns.
    pub fn products(self, unknowns: &[f64]) -> Vec<f64> {
        let product = |(start, row): &Row<'_>| -> f64 {
            let terms = row.iter().zip(&unknowns[*start..]);
            terms.map(|(entry, unknown)| entry * unknown).sum()
        };
        self.rows().iter().map(product).collect()
    }

    /// Whether all sizes agree and no nonzero entry is after the last unknown.
    pub fn fit(self) -> bool {
        self.width > 0
            && self.entries.len() == self.first.len() * self.width
            && self
                .rows()
                .iter()
                .all(|(start, row)| row.is_empty() || start + row.len() <= self.unknowns)
    }
}

/// The first unknown of a row, and its entries.
type Row<'a> = (usize, &'a [f64]);

/// Right-hand sides after elimination of the unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Elimination {
    /// Solution G^-1 Z' Y, (unknowns, sides).
    pub solution: Vec<f64>,
    /// Residuals Y - Z G^-1 Z' Y, (rows, sides).
    pub residuals: Vec<f64>,
    /// Diagonal of Z G^-1 Z', (rows,).
    pub leverage: Vec<f64>,
}

/// Eliminates the unknowns of `z` from `y`, (rows, sides).
///
/// Returns `None` if an entry is not finite.
#[inline(always)]
pub(crate) fn eliminate<const FUSED: bool>(
    z: Windows<'_>,
    y: &[f64],
    sides: usize,
) -> Option<Elimination> {
    let n = z.unknowns;
    let rows = z.rows();
    let first = envelope(&rows, n);
    let factor = factorise::<FUSED>(&rows, &first)?;
    let mut solution = moments::<FUSED>(&rows, y, n, sides);
    substitute::<FUSED>(&factor, &first, &mut solution, sides);
    let mut residuals = y.to_vec();
    for ((start, row), residual) in rows.iter().zip(residuals.chunks_exact_mut(sides)) {
        subtract_product::<FUSED>(residual, row, &solution[start * sides..]);
    }
    Some(Elimination {
        solution,
        residuals,
        leverage: leverages::<FUSED>(&rows, &inverse_within::<FUSED>(&factor, &first)),
    })
}

/// A square band matrix, stored row by row.
struct Band {
    /// Entries of a row left of the diagonal.
    left: usize,
    /// Entries of a row.
    width: usize,
    entries: Vec<f64>,
}

impl Band {
    /// A zero matrix of `n` rows with `left` and `right` entries on the two sides of the diagonal.
    fn new(n: usize, left: usize, right: usize) -> Self {
        let width = left + 1 + right;
        Self {
            left,
            width,
            entries: vec![0.0; n * width],
        }
    }

    /// Index of an entry, which must lie within the band.
    #[inline(always)]
    fn place(&self, row: usize, column: usize) -> usize {
        row * self.width + column + self.left - row
    }

    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[self.place(row, column)]
    }

    /// Entries of a row, from one column up to another, which is excluded.
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
    fn add(&mut self, row: usize, column: usize, value: f64) {
        let place = self.place(row, column);
        self.entries[place] += value;
    }

    #[inline(always)]
    fn set(&mut self, row: usize, column: usize, value: f64) {
        let place = self.place(row, column);
        self.entries[place] = value;
    }
}

/// Z'Y, (unknowns, sides).
#[inline(always)]
fn moments<const FUSED: bool>(rows: &[Row<'_>], y: &[f64], n: usize, sides: usize) -> Vec<f64> {
    let mut sums = vec![0.0; n * sides];
    let mut columns = Vec::new();
    for (rows, y) in rows.chunks(LANES).zip(y.chunks(LANES * sides)) {
        let start = side_by_side(rows, -1.0, &mut columns);
        let targets = sums[start * sides..].chunks_exact_mut(sides);
        for (target, column) in targets.zip(&columns) {
            subtract_product::<FUSED>(target, &column[..rows.len()], y);
        }
    }
    sums
}

/// Entries of a few rows times a factor, side by side for each unknown; the first unknown.
#[inline(always)]
fn side_by_side(rows: &[Row<'_>], factor: f64, columns: &mut Vec<[f64; LANES]>) -> usize {
    let (start, stop) = range(rows);
    columns.clear();
    columns.resize(stop - start, [0.0; LANES]);
    for (lane, (begin, row)) in rows.iter().enumerate() {
        for (i, &value) in row.iter().enumerate() {
            columns[begin - start + i][lane] = factor * value;
        }
    }
    start
}

/// Range of the unknowns of a few rows; empty if they have none.
#[inline(always)]
fn range(rows: &[Row<'_>]) -> (usize, usize) {
    let filled = rows.iter().filter(|(_, row)| !row.is_empty());
    let (start, stop) = filled.fold((usize::MAX, 0), |(start, stop), (begin, row)| {
        (start.min(*begin), stop.max(begin + row.len()))
    });
    (start.min(stop), stop)
}

/// Lower Cholesky factor of G.
#[inline(always)]
fn factorise<const FUSED: bool>(rows: &[Row<'_>], first: &[usize]) -> Option<Band> {
    let mut factor = Band::new(first.len(), reach(first), 0);
    let mut products = Products::default();
    for rows in rows.chunks(ROWS_PER_PASS) {
        products.add::<FUSED>(&mut factor, rows);
    }
    decompose::<FUSED>(&mut factor, first)?;
    Some(factor)
}

/// Largest distance of the envelope from the diagonal.
fn reach(first: &[usize]) -> usize {
    let distances = first.iter().enumerate().map(|(i, first)| i - first);
    distances.max().unwrap_or(0)
}

/// Products of right-hand sides minus the part that the unknowns explain, each (sides, sides).
pub(crate) struct ResidualProducts {
    /// Y'Y - Y'Z G^-1 Z'Y of all rows.
    pub total: Vec<f64>,
    /// The same without the rows of each block.
    pub without: Vec<Vec<f64>>,
    /// Solution G^-1 Z' Y of all rows, (unknowns, sides).
    pub solution: Vec<f64>,
}

/// Leave-one-block-out products for blocks of successive rows, whose ends (excluded) are `stops`.
///
/// The unknowns of a block reach from the first of its rows to the last. Unknowns before the block
/// are eliminated once from the beginning, unknowns after it once from the end; only the unknowns
/// of the block are eliminated again. All blocks together therefore cost little more than two
/// eliminations of all rows.
///
/// Returns `None` if an entry is not finite.
#[inline(always)]
pub(crate) fn residual_products_without_blocks<const FUSED: bool>(
    z: Windows<'_>,
    y: &[f64],
    sides: usize,
    stops: &[usize],
) -> Option<ResidualProducts> {
    let rows = z.rows();
    let reversed_entries: Vec<f64> = z.entries.iter().rev().copied().collect();
    let reversed: Vec<Row<'_>> = rows
        .iter()
        .rev()
        .zip(reversed_entries.chunks_exact(z.width))
        .map(|((start, row), window)| {
            // an empty row has no first unknown
            let begin = if row.is_empty() {
                0
            } else {
                z.unknowns - start - row.len()
            };
            let zeros = window.iter().position(|&v| v != 0.0).unwrap_or(0);
            (begin, &window[zeros..][..row.len()])
        })
        .collect();
    let y_reversed: Vec<f64> = y.chunks_exact(sides).rev().flatten().copied().collect();
    let before = OneSidedElimination::of::<FUSED>(&rows, y, z.unknowns, sides)?;
    let after = OneSidedElimination::of::<FUSED>(&reversed, &y_reversed, z.unknowns, sides)?;
    // Y'Y of each block, and of the rows after the last one
    let mut own = Vec::with_capacity(stops.len() + 1);
    let mut start = 0;
    for &stop in stops.iter().chain([&rows.len()]) {
        let mut sums = vec![0.0; sides * sides];
        for y in y[start * sides..stop * sides].chunks_exact(sides) {
            add_square::<FUSED>(&mut sums, y, 1.0);
        }
        own.push(sums);
        start = stop;
    }
    let mut without = Vec::with_capacity(stops.len());
    start = 0;
    for (k, &stop) in stops.iter().enumerate() {
        let remaining = RemainingRows {
            rows: &rows,
            y,
            sides,
            block: (start, stop),
        };
        let others = own.iter().enumerate().filter(|(other, _)| *other != k);
        let mut sums = vec![0.0; sides * sides];
        others.for_each(|(_, each)| add_scaled::<false>(&mut sums, 1.0, each));
        remaining.subtract_explained::<FUSED>(&before, &after, &mut sums)?;
        without.push(sums);
        start = stop;
    }
    let mut total = vec![0.0; sides * sides];
    own.iter()
        .for_each(|each| add_scaled::<false>(&mut total, 1.0, each));
    add_scaled::<FUSED>(&mut total, -1.0, before.squares(z.unknowns));
    let mut solution = before.solved;
    substitute_backward::<FUSED>(&before.factor, &before.first, &mut solution, sides);
    Some(ResidualProducts {
        total,
        without,
        solution,
    })
}

/// Elimination of all rows from one end.
struct OneSidedElimination {
    first: Vec<usize>,
    factor: Band,
    /// L^-1 Z'Y, (unknowns, sides).
    solved: Vec<f64>,
    /// Products of its rows, summed over the first 0, 1, ... of them: (unknowns + 1, sides, sides).
    squares: Vec<f64>,
}

impl OneSidedElimination {
    #[inline(always)]
    fn of<const FUSED: bool>(rows: &[Row<'_>], y: &[f64], n: usize, sides: usize) -> Option<Self> {
        let first = envelope(rows, n);
        let factor = factorise::<FUSED>(rows, &first)?;
        let mut solved = moments::<FUSED>(rows, y, n, sides);
        substitute_forward::<FUSED>(&factor, &first, &mut solved, sides);
        let mut squares = vec![0.0; (n + 1) * sides * sides];
        for (k, row) in solved.chunks_exact(sides).enumerate() {
            let (done, next) = squares.split_at_mut((k + 1) * sides * sides);
            next[..sides * sides].copy_from_slice(&done[k * sides * sides..]);
            add_square::<FUSED>(&mut next[..sides * sides], row, 1.0);
        }
        Some(Self {
            first,
            factor,
            solved,
            squares,
        })
    }

    /// Products of the rows of L^-1 Z'Y of the first `count` unknowns.
    #[inline(always)]
    fn squares(&self, count: usize) -> &[f64] {
        let size = self.squares.len() / (self.first.len() + 1);
        &self.squares[count * size..][..size]
    }
}

/// All rows except those of one block.
struct RemainingRows<'a> {
    rows: &'a [Row<'a>],
    y: &'a [f64],
    sides: usize,
    /// Range of rows of the block; the end is excluded.
    block: (usize, usize),
}

impl RemainingRows<'_> {
    /// Subtracts what the unknowns explain of the remaining rows from their products.
    #[inline(always)]
    fn subtract_explained<const FUSED: bool>(
        &self,
        before: &OneSidedElimination,
        after: &OneSidedElimination,
        sums: &mut [f64],
    ) -> Option<()> {
        let (n, sides) = (before.first.len(), self.sides);
        let (from, to) = self.between(&before.first);
        let count = to - from;
        // equations of the remaining rows for the block's unknowns
        let mut rows: Vec<Row<'_>> = Vec::new();
        let mut right = vec![0.0; count * sides];
        let (start, stop) = self.block;
        for (k, y) in self.y.chunks_exact(sides).enumerate() {
            if (start..stop).contains(&k) {
                continue;
            }
            let (begin, row) = self.rows[k];
            let (low, high) = (begin.max(from), (begin + row.len()).min(to));
            if low < high {
                let inside = &row[low - begin..high - begin];
                rows.push((low - from, inside));
                for (i, &value) in inside.iter().enumerate() {
                    add_scaled::<FUSED>(&mut right[(low - from + i) * sides..][..sides], value, y);
                }
            }
        }
        add_scaled::<FUSED>(sums, -1.0, before.squares(from));
        add_scaled::<FUSED>(sums, -1.0, after.squares(n - to));
        let first: Vec<usize> = (from..to)
            .map(|i| before.first[i].max(from) - from)
            .collect();
        let mut middle = Band::new(count, reach(&first), 0);
        let mut products = Products::default();
        for rows in rows.chunks(ROWS_PER_PASS) {
            products.add::<FUSED>(&mut middle, rows);
        }
        let (low, high) = (from, n - to); // numbers of unknowns before and after the block
        for i in from..to {
            let begin = before.first[i];
            for j in from..=i {
                let begin = begin.max(before.first[j]);
                if begin < low {
                    let taken = dot::<FUSED>(
                        before.factor.row(i, begin, low),
                        before.factor.row(j, begin, low),
                    );
                    middle.add(i - from, j - from, -taken);
                }
            }
            let side = &mut right[(i - from) * sides..][..sides];
            if begin < low {
                let weights = before.factor.row(i, begin, low);
                subtract_product::<FUSED>(side, weights, &before.solved[begin * sides..]);
            }
            // unknowns after the block are numbered from the end
            let reversed = n - 1 - i;
            let begin = after.first[reversed];
            for j in i..to {
                let begin = begin.max(after.first[n - 1 - j]);
                if begin < high {
                    let taken = dot::<FUSED>(
                        after.factor.row(reversed, begin, high),
                        after.factor.row(n - 1 - j, begin, high),
                    );
                    middle.add(j - from, i - from, -taken);
                }
            }
            if begin < high {
                let weights = after.factor.row(reversed, begin, high);
                subtract_product::<FUSED>(side, weights, &after.solved[begin * sides..]);
            }
        }
        decompose::<FUSED>(&mut middle, &first)?;
        substitute_forward::<FUSED>(&middle, &first, &mut right, sides);
        for solved in right.chunks_exact(sides) {
            add_square::<FUSED>(sums, solved, -1.0);
        }
        Some(())
    }

    /// Range of the unknowns of the block; all unknowns if other rows span the whole block.
    fn between(&self, first: &[usize]) -> (usize, usize) {
        let n = first.len();
        let (start, stop) = self.block;
        let rows = self.rows[start..stop]
            .iter()
            .filter(|(_, row)| !row.is_empty());
        let (from, to) = rows.fold((n, 0), |(from, to), (begin, row)| {
            (from.min(*begin), to.max(begin + row.len()))
        });
        if from > to {
            (n, n) // no unknowns: treat all as before the block
        } else if to < n && first[to] < from {
            (0, n)
        } else {
            (from, to)
        }
    }
}

/// Adds `sign` y'y to a square matrix.
#[inline(always)]
fn add_square<const FUSED: bool>(target: &mut [f64], y: &[f64], sign: f64) {
    for (row, &value) in target.chunks_exact_mut(y.len()).zip(y) {
        add_scaled::<FUSED>(row, sign * value, y);
    }
}

/// Adds the products Z'Z of a few adjacent rows to the lower half of a matrix.
///
/// Adjacent rows have nearly the same unknowns. Adding four rows in one pass halves the memory
/// traffic.
#[derive(Default)]
struct Products {
    /// The rows, padded with zeros to the same range of unknowns.
    aligned: [Vec<f64>; ROWS_PER_PASS],
}

impl Products {
    #[inline(always)]
    fn add<const FUSED: bool>(&mut self, matrix: &mut Band, rows: &[Row<'_>]) {
        let (start, stop) = range(rows);
        if stop <= start {
            return;
        }
        if stop - start > matrix.left + 1 {
            // the rows together span more unknowns than the band; each row alone fits
            for row in rows {
                add_alone::<FUSED>(matrix, *row);
            }
            return;
        }
        for (k, aligned) in self.aligned.iter_mut().enumerate() {
            aligned.clear();
            aligned.resize(stop - start, 0.0);
            if let Some((begin, row)) = rows.get(k).filter(|(_, row)| !row.is_empty()) {
                aligned[begin - start..][..row.len()].copy_from_slice(row);
            }
        }
        for i in 0..stop - start {
            let target = matrix.row_mut(start + i, start, start + i + 1);
            let four: [&[f64]; ROWS_PER_PASS] = std::array::from_fn(|k| &self.aligned[k][..=i]);
            add_four::<FUSED>(target, four.map(|row| row[i]), four);
        }
    }
}

/// Adds the products of one row.
#[inline(always)]
fn add_alone<const FUSED: bool>(matrix: &mut Band, (start, row): Row<'_>) {
    for (i, &value) in row.iter().enumerate() {
        let target = matrix.row_mut(start + i, start, start + i + 1);
        add_scaled::<FUSED>(target, value, &row[..=i]);
    }
}

/// z' S z of each row, from the lower half of S.
#[inline(always)]
fn leverages<const FUSED: bool>(rows: &[Row<'_>], inverse: &Band) -> Vec<f64> {
    let mut leverage = Vec::with_capacity(rows.len());
    let mut columns = Vec::new();
    for rows in rows.chunks(LANES) {
        let start = side_by_side(rows, 1.0, &mut columns);
        let mut sums = [0.0; LANES];
        for (i, column) in columns.iter().enumerate() {
            // no row has unknowns beyond the band together
            let from = i.saturating_sub(inverse.left);
            let entries = inverse.row(start + i, start + from, start + i + 1);
            let mut below = [0.0; LANES];
            for (entry, other) in entries[..i - from].iter().zip(&columns[from..]) {
                for lane in 0..LANES {
                    below[lane] = multiply_add::<FUSED>(*entry, other[lane], below[lane]);
                }
            }
            for lane in 0..LANES {
                let product =
                    multiply_add::<FUSED>(entries[i - from], column[lane], 2.0 * below[lane]);
                sums[lane] = multiply_add::<FUSED>(column[lane], product, sums[lane]);
            }
        }
        leverage.extend_from_slice(&sums[..rows.len()]);
    }
    leverage
}

/// A window without its leading and trailing zeros.
fn trim_zeros<'a>((&first, window): (&usize, &'a [f64])) -> Row<'a> {
    let start = window.iter().position(|&v| v != 0.0).unwrap_or(0);
    let stop = window
        .iter()
        .rposition(|&v| v != 0.0)
        .map_or(start, |last| last + 1);
    (first + start, &window[start..stop])
}

/// For each unknown, the first unknown that occurs in a row with it; non-decreasing.
fn envelope(rows: &[Row<'_>], n: usize) -> Vec<usize> {
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

/// Lower Cholesky factor of G; `matrix` holds Z'Z.
#[inline(always)]
fn decompose<const FUSED: bool>(matrix: &mut Band, first: &[usize]) -> Option<()> {
    let n = first.len();
    for start in (0..n).step_by(ROWS_PER_PASS) {
        let stop = (start + ROWS_PER_PASS).min(n);
        // an entry needs those before it in its row: several rows at once hide the latency
        for j in first[start]..start {
            for i in (start..stop).take_while(|i| first[*i] <= j) {
                eliminate_entry::<FUSED>(matrix, first, i, j);
            }
        }
        for i in start..stop {
            for j in first[i].max(start)..i {
                eliminate_entry::<FUSED>(matrix, first, i, j);
            }
            let entries = matrix.row(i, first[i], i);
            let pivot = 1.0 + matrix.at(i, i) - dot::<FUSED>(entries, entries);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            matrix.set(i, i, pivot.sqrt());
        }
    }
    Some(())
}

/// Computes an entry of the factor left of the diagonal.
#[inline(always)]
fn eliminate_entry<const FUSED: bool>(matrix: &mut Band, first: &[usize], i: usize, j: usize) {
    let from = first[i].max(first[j]);
    let shared = dot::<FUSED>(matrix.row(i, from, j), matrix.row(j, from, j));
    matrix.set(i, j, (matrix.at(i, j) - shared) / matrix.at(j, j));
}

/// L^-1 times several right-hand sides, in place.
#[inline(always)]
fn substitute_forward<const FUSED: bool>(
    factor: &Band,
    first: &[usize],
    right: &mut [f64],
    sides: usize,
) {
    for i in 0..first.len() {
        let (above, row) = right.split_at_mut(i * sides);
        let (row, known) = (&mut row[..sides], &above[first[i] * sides..]);
        subtract_product::<FUSED>(row, factor.row(i, first[i], i), known);
        row.iter_mut().for_each(|v| *v /= factor.at(i, i));
    }
}

/// G^-1 times several right-hand sides, in place.
#[inline(always)]
fn substitute<const FUSED: bool>(factor: &Band, first: &[usize], right: &mut [f64], sides: usize) {
    substitute_forward::<FUSED>(factor, first, right, sides);
    substitute_backward::<FUSED>(factor, first, right, sides);
}

/// L'^-1 times several right-hand sides, in place.
#[inline(always)]
fn substitute_backward<const FUSED: bool>(
    factor: &Band,
    first: &[usize],
    right: &mut [f64],
    sides: usize,
) {
    let mut column = Vec::with_capacity(factor.left);
    let mut stop = first.len(); // end of the rows of L that contain unknown i
    for i in (0..first.len()).rev() {
        while stop > i + 1 && first[stop - 1] > i {
            stop -= 1;
        }
        column.clear();
        for k in i + 1..stop {
            column.push(factor.at(k, i));
        }
        let (row, below) = right[i * sides..].split_at_mut(sides);
        subtract_product::<FUSED>(row, &column, below);
        row.iter_mut().for_each(|v| *v /= factor.at(i, i));
    }
}

/// Entries of G^-1 within the envelope and its mirror image; zeros elsewhere.
///
/// S_ij = (d_ij / L_ii - sum over k > i of L_ki S_kj) / L_ii, from the last row to the first.
#[inline(always)]
fn inverse_within<const FUSED: bool>(factor: &Band, first: &[usize]) -> Band {
    let n = first.len();
    let mut inverse = Band::new(n, factor.left, factor.left);
    let mut weights = Vec::with_capacity(factor.left);
    let mut row = Vec::with_capacity(factor.left);
    let mut stop = n; // end of the rows of L that contain unknown i
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
        for four in weights.chunks(ROWS_PER_PASS) {
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
        let diagonal = 1.0 / (pivot * pivot) + dot::<FUSED>(&weights, &row);
        inverse.set(i, i, diagonal);
        inverse.row_mut(i, i + 1, stop).copy_from_slice(&row);
        for (k, &entry) in (i + 1..stop).zip(&row) {
            inverse.set(k, i, entry);
        }
    }
    inverse
}

/// Adds four weighted rows in one pass, which needs a quarter of the memory traffic.
#[inline(always)]
fn add_four<const FUSED: bool>(
    target: &mut [f64],
    weights: [f64; ROWS_PER_PASS],
    sources: [&[f64]; ROWS_PER_PASS],
) {
    let [a, b, c, d] = sources.map(|source| &source[..target.len()]);
    for i in 0..target.len() {
        let one = multiply_add::<FUSED>(weights[0], a[i], target[i]);
        let two = multiply_add::<FUSED>(weights[1], b[i], one);
        let three = multiply_add::<FUSED>(weights[2], c[i], two);
        target[i] = multiply_add::<FUSED>(weights[3], d[i], three);
    }
}

/// Subtracts the product of a row of weights and as many rows, which begin with `rows`.
#[inline(always)]
fn subtract_product<const FUSED: bool>(target: &mut [f64], weights: &[f64], rows: &[f64]) {
    let width = target.len();
    let mut done = 0;
    while done < width {
        done += match width - done {
            8.. => subtract_columns::<FUSED, 8>(target, done, weights, rows),
            4..8 => subtract_columns::<FUSED, 4>(target, done, weights, rows),
            _ => subtract_columns::<FUSED, 1>(target, done, weights, rows),
        };
    }
}

/// Computes the next `COLUMNS` numbers of such a difference in registers; their number.
#[inline(always)]
fn subtract_columns<const FUSED: bool, const COLUMNS: usize>(
    target: &mut [f64],
    from: usize,
    weights: &[f64],
    rows: &[f64],
) -> usize {
    let width = target.len();
    let numbers: &mut [f64; COLUMNS] = (&mut target[from..from + COLUMNS])
        .try_into()
        .expect("COLUMNS numbers");
    let mut rest = *numbers;
    for (k, weight) in weights.iter().enumerate() {
        let row: &[f64; COLUMNS] = rows[k * width + from..][..COLUMNS]
            .try_into()
            .expect("COLUMNS numbers");
        for i in 0..COLUMNS {
            rest[i] = multiply_add::<FUSED>(-weight, row[i], rest[i]);
        }
    }
    *numbers = rest;
    COLUMNS
}

#[inline(always)]
fn add_scaled<const FUSED: bool>(target: &mut [f64], weight: f64, source: &[f64]) {
    // indices instead of `zip`, whose call is not always compiled inline
    let source = &source[..target.len()];
    for i in 0..target.len() {
        target[i] = multiply_add::<FUSED>(weight, source[i], target[i]);
    }
}

#[inline(always)]
fn dot<const FUSED: bool>(left: &[f64], right: &[f64]) -> f64 {
    const PARTS: usize = 4;
    const UNROLLED_LENGTH: usize = 4 * PARTS; // enough independent sums to hide the latency of an addition
    let right = &right[..left.len()];
    let mut sums = [0.0; UNROLLED_LENGTH];
    let mut at = 0;
    while at + UNROLLED_LENGTH <= left.len() {
        let (l, r) = (
            &left[at..][..UNROLLED_LENGTH],
            &right[at..][..UNROLLED_LENGTH],
        );
        for lane in 0..UNROLLED_LENGTH {
            sums[lane] = multiply_add::<FUSED>(l[lane], r[lane], sums[lane]);
        }
        at += UNROLLED_LENGTH;
    }
    let mut sum: [f64; PARTS] =
        std::array::from_fn(|i| (sums[i] + sums[4 + i]) + (sums[8 + i] + sums[12 + i]));
    while at + PARTS <= left.len() {
        let (l, r) = (&left[at..][..PARTS], &right[at..][..PARTS]);
        for lane in 0..PARTS {
            sum[lane] = multiply_add::<FUSED>(l[lane], r[lane], sum[lane]);
        }
        at += PARTS;
    }
    let mut rest = 0.0;
    for i in at..left.len() {
        rest += left[i] * right[i];
    }
    (sum[0] + sum[1]) + (sum[2] + sum[3]) + rest
}

#[cfg(test)]
mod tests;
