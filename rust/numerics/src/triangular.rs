//! Triangular factor R of a table with many rows, A = QR, in one pass over the rows.
//!
//! The rows are gathered in blocks that fit into the processor's second-level cache, and
//! Householder reflections of [R; block] annihilate each block (sequential tall-skinny QR; Demmel,
//! Grigori, Hoemmen and Langou, SIAM Journal on Scientific Computing 34, 2012). Since R is
//! triangular, the reflection of a column changes one row of R. The reflections of a panel of
//! columns are applied to other columns as one product I - V T' V' (Schreiber and Van Loan, SIAM
//! Journal on Scientific and Statistical Computing 10, 1989).

use crate::products::{BASELINE_IS_FUSED, multiply_add};

/// Columns of a panel.
const PANEL: usize = 8;
/// Rows of a block: a panel of them and one of the reflections fit into the first-level cache.
const BLOCK: usize = 192;
/// Rows whose updates are kept in registers (`ROWS` below), and those with AVX-512; `BLOCK` is a
/// multiple.
const TILE_ROWS: [usize; 2] = [6, 12];
/// Reflections whose products are kept in registers (`REFLECTIONS` below), and those with AVX-512.
const TILE_REFLECTIONS: [usize; 2] = [4, 8];
/// Sums over every third row, so that no sum waits for the previous one; a divisor of `TILE_ROWS`.
const SEPARATE_SUMS: usize = 3;
/// Sum of squares below which a column is zero: smaller sums are inaccurate.
const MIN_SQUARE: f64 = f64::MIN_POSITIVE / f64::EPSILON;

/// Entries of one row in the columns of a panel.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Row([f64; PANEL]);

/// Square matrix of a panel.
type Tile = [[f64; PANEL]; PANEL];

const ZERO_ROW: Row = Row([0.0; PANEL]);
const ZERO_TILE: Tile = [[0.0; PANEL]; PANEL];

/// Reflections I - V T' V' of the columns of a panel, with V = [I; X diag(scale)].
///
/// The identity matrix is in the rows of R. X is in the block, where it replaces the panel.
#[derive(Clone, Copy)]
struct Reflections {
    scale: [f64; PANEL],
    /// Transpose of the triangular T.
    transpose: Tile,
}

/// Triangular factor of the rows added so far.
///
/// Backward stable for entries whose squares neither overflow nor underflow. Entries that are not
/// finite make those of R not finite.
pub struct TriangularFactor {
    columns: usize,
    panels: usize,
    /// Tiles (panels, panels) of R, zero below the diagonal.
    r: Vec<Tile>,
    /// Rows (panels, BLOCK) that R does not contain yet.
    block: Vec<Row>,
    rows: usize,
    reflections: Vec<Reflections>,
}

impl TriangularFactor {
    /// The factor of a table with `columns` columns and no rows.
    pub fn new(columns: usize) -> Self {
        let panels = columns.div_ceil(PANEL);
        let none = Reflections {
            scale: [0.0; PANEL],
            transpose: ZERO_TILE,
        };
        Self {
            columns,
            panels,
            r: vec![ZERO_TILE; panels * panels],
            block: vec![ZERO_ROW; panels * BLOCK],
            rows: 0,
            reflections: vec![none; panels],
        }
    }

    /// Adds a row of the table.
    pub fn add(&mut self, row: &[f64]) {
        assert_eq!(row.len(), self.columns);
        for (panel, entries) in row.chunks(PANEL).enumerate() {
            self.block[panel * BLOCK + self.rows].0[..entries.len()].copy_from_slice(entries);
        }
        self.rows += 1;
        if self.rows == BLOCK {
            self.reduce();
        }
    }

    /// R, (columns, columns) row-major. Row j is zero if all entries of column j are.
    pub fn finish(mut self) -> Vec<f64> {
        let padded = self.rows.next_multiple_of(TILE_ROWS[1]);
        for panel in self.block.chunks_exact_mut(BLOCK) {
            panel[self.rows..padded].fill(ZERO_ROW);
        }
        self.rows = padded;
        self.reduce();
        let entry = |(i, j): (usize, usize)| {
            self.r[i / PANEL * self.panels + j / PANEL][i % PANEL][j % PANEL]
        };
        let places = (0..self.columns).flat_map(|i| (0..self.columns).map(move |j| (i, j)));
        places.map(entry).collect()
    }

    /// Makes the factor contain the block.
    fn reduce(&mut self) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: all features have just been detected.
                return unsafe { self.reduce_avx512() };
            }
            // SAFETY: both features have just been detected.
            return unsafe { self.reduce_avx2() };
        }
        self.reduce_with::<BASELINE_IS_FUSED, { TILE_ROWS[0] }, { TILE_REFLECTIONS[0] }>();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,avx512f")]
    fn reduce_avx512(&mut self) {
        self.reduce_with::<true, { TILE_ROWS[1] }, { TILE_REFLECTIONS[1] }>();
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn reduce_avx2(&mut self) {
        self.reduce_with::<true, { TILE_ROWS[0] }, { TILE_REFLECTIONS[0] }>();
    }

    #[inline(always)]
    fn reduce_with<const FUSED: bool, const ROWS: usize, const REFLECTIONS: usize>(&mut self) {
        for j in 0..self.panels {
            let (earlier, later) = self.block.split_at_mut(j * BLOCK);
            let panel = &mut later[..self.rows];
            for (i, x) in earlier.chunks_exact(BLOCK).enumerate() {
                let r = &mut self.r[i * self.panels + j];
                let x = &x[..self.rows];
                self.reflections[i].apply::<FUSED, ROWS, REFLECTIONS>(x, r, panel);
            }
            self.reflections[j] = annihilate::<FUSED>(&mut self.r[j * self.panels + j], panel);
        }
        self.rows = 0;
    }
}

/// R of a table with rows of `columns` entries, (columns, columns) row-major.
pub fn factor(table: &[f64], columns: usize) -> Vec<f64> {
    let mut factor = TriangularFactor::new(columns);
    if columns > 0 {
        table.chunks_exact(columns).for_each(|row| factor.add(row));
    }
    factor.finish()
}

/// Derivatives of all rows with respect to some of the unknowns.
#[derive(Clone, Copy)]
pub struct Columns<'a> {
    /// Derivatives (samples, channels, unknowns), row-major.
    pub values: &'a [f64],
    /// Number of unknowns.
    pub unknowns: usize,
}

/// Rows of a linearised least-squares problem, with a factor for each row.
#[derive(Clone, Copy)]
pub struct WeightedRows<'a> {
    /// Derivatives of the rows side by side, without the factors.
    pub columns: &'a [Columns<'a>],
    /// Factors (samples, channels).
    pub scale: &'a [f64],
    /// Residuals (samples, channels), with their factors.
    pub residual: &'a [f64],
    /// Number of channels.
    pub channels: usize,
}

impl WeightedRows<'_> {
    /// R of [scale columns, residual], (unknowns + 1, unknowns + 1) row-major, after elimination of
    /// a constant in the unscaled rows of each channel of `biased`.
    pub fn factor(self, biased: &[usize]) -> Vec<f64> {
        let n = self.unknowns();
        let constants = self.constants(biased);
        let mut factor = TriangularFactor::new(n + 1);
        let mut weighted = vec![0.0; n + 1];
        for at in 0..self.scale.len() {
            let scale = self.scale[at];
            let constant = &constants[at % self.channels * (n + 1)..][..n + 1];
            let mut begin = 0;
            for &Columns { values, unknowns } in self.columns {
                let own = &values[at * unknowns..][..unknowns];
                let constant = &constant[begin..][..unknowns];
                let row = &mut weighted[begin..][..unknowns];
                for k in 0..unknowns {
                    row[k] = scale * (own[k] - constant[k]);
                }
                begin += unknowns;
            }
            weighted[n] = self.residual[at] - scale * constant[n];
            factor.add(&weighted);
        }
        factor.finish()
    }

    /// Number of unknowns of all columns.
    pub fn unknowns(self) -> usize {
        self.columns.iter().map(|part| part.unknowns).sum()
    }

    /// Constants (channels, unknowns + 1) that fit the unscaled rows best; zero without a bias.
    fn constants(self, biased: &[usize]) -> Vec<f64> {
        let n = self.unknowns();
        let mut constants = vec![0.0; self.channels * (n + 1)];
        let mut power = vec![0.0; self.channels];
        let samples = self.scale.len().checked_div(self.channels).unwrap_or(0);
        for sample in 0..samples {
            for &channel in biased {
                let at = sample * self.channels + channel;
                let scale = self.scale[at];
                let sums = &mut constants[channel * (n + 1)..][..n + 1];
                let weight = scale * scale;
                let mut begin = 0;
                for &Columns { values, unknowns } in self.columns {
                    let own = &values[at * unknowns..][..unknowns];
                    let sums = &mut sums[begin..][..unknowns];
                    for k in 0..unknowns {
                        sums[k] += weight * own[k];
                    }
                    begin += unknowns;
                }
                sums[n] += scale * self.residual[at];
                power[channel] += weight;
            }
        }
        for (sums, power) in constants.chunks_exact_mut(n + 1).zip(power) {
            let divisor = if power > 0.0 { power } else { 1.0 };
            sums.iter_mut().for_each(|sum| *sum /= divisor);
        }
        constants
    }
}

impl Reflections {
    /// Applies the reflections with the entries `x` in the block to columns of R and of the block.
    #[inline(always)]
    fn apply<const FUSED: bool, const ROWS: usize, const REFLECTIONS: usize>(
        &self,
        x: &[Row],
        r: &mut Tile,
        block: &mut [Row],
    ) {
        // V' [R; block]
        let mut sums = products::<FUSED, REFLECTIONS>(x, block);
        for k in 0..PANEL {
            for b in 0..PANEL {
                sums[k][b] = multiply_add::<FUSED>(self.scale[k], sums[k][b], r[k][b]);
            }
        }
        let mut steps = ZERO_TILE;
        for a in 0..PANEL {
            for k in 0..=a {
                for b in 0..PANEL {
                    steps[a][b] =
                        multiply_add::<FUSED>(self.transpose[a][k], sums[k][b], steps[a][b]);
                }
            }
            for b in 0..PANEL {
                r[a][b] -= steps[a][b];
                steps[a][b] *= -self.scale[a];
            }
        }
        add_multiples::<FUSED, ROWS>(block, x, &steps);
    }
}

/// Reflections that annihilate a panel of the block below the diagonal tile of R.
#[inline(always)]
fn annihilate<const FUSED: bool>(r: &mut Tile, panel: &mut [Row]) -> Reflections {
    let mut scale = [0.0; PANEL];
    let mut transpose = ZERO_TILE;
    // products of the column with all columns of the panel
    let mut sums = update::<FUSED>(panel, 0, &[0.0; PANEL], 0);
    for j in 0..PANEL {
        let mut step = [0.0; PANEL];
        if sums[j] >= MIN_SQUARE || sums[j].is_nan() {
            let diagonal = r[j][j];
            let norm = (diagonal * diagonal + sums[j]).sqrt();
            let reflected = if diagonal > 0.0 { -norm } else { norm };
            scale[j] = 1.0 / (diagonal - reflected);
            let tau = (reflected - diagonal) / reflected;
            // column j of T: -tau T V'v above the diagonal
            for i in 0..j {
                for k in i..j {
                    let product = scale[k] * scale[j] * sums[k];
                    transpose[j][i] -= tau * transpose[k][i] * product;
                }
            }
            transpose[j][j] = tau;
            for k in j + 1..PANEL {
                let change = tau * (r[j][k] + scale[j] * sums[k]);
                r[j][k] -= change;
                step[k] = -scale[j] * change;
            }
            r[j][j] = reflected;
        }
        if j + 1 < PANEL {
            sums = update::<FUSED>(panel, j, &step, j + 1);
        }
    }
    Reflections { scale, transpose }
}

/// Adds multiples of a column to the columns of a panel. Returns the products of another column
/// with them.
#[inline(always)]
fn update<const FUSED: bool>(
    panel: &mut [Row],
    column: usize,
    multiples: &[f64; PANEL],
    other: usize,
) -> [f64; PANEL] {
    let mut sums = [[0.0; PANEL]; SEPARATE_SUMS];
    for rows in panel.chunks_exact_mut(SEPARATE_SUMS) {
        for (Row(row), sum) in rows.iter_mut().zip(&mut sums) {
            let entry = row[column];
            let next = multiply_add::<FUSED>(entry, multiples[other], row[other]);
            for b in 0..PANEL {
                row[b] = multiply_add::<FUSED>(entry, multiples[b], row[b]);
                sum[b] = multiply_add::<FUSED>(next, row[b], sum[b]);
            }
        }
    }
    let mut total = [0.0; PANEL];
    for sum in sums {
        for b in 0..PANEL {
            total[b] += sum[b];
        }
    }
    total
}

/// Sums x' block over the rows.
#[inline(always)]
fn products<const FUSED: bool, const REFLECTIONS: usize>(x: &[Row], block: &[Row]) -> Tile {
    let mut sums = ZERO_TILE;
    for (part, target) in sums.chunks_exact_mut(REFLECTIONS).enumerate() {
        let first = part * REFLECTIONS;
        let mut tile = [[0.0; PANEL]; REFLECTIONS];
        for (Row(x), Row(row)) in x.iter().zip(block) {
            for a in 0..REFLECTIONS {
                for b in 0..PANEL {
                    tile[a][b] = multiply_add::<FUSED>(x[first + a], row[b], tile[a][b]);
                }
            }
        }
        target.copy_from_slice(&tile);
    }
    sums
}

/// Adds x steps to the rows of a block.
#[inline(always)]
fn add_multiples<const FUSED: bool, const ROWS: usize>(block: &mut [Row], x: &[Row], steps: &Tile) {
    let tiles = block.chunks_exact_mut(ROWS);
    for (rows, x) in tiles.zip(x.chunks_exact(ROWS)) {
        let mut tile: [[f64; PANEL]; ROWS] = std::array::from_fn(|a| rows[a].0);
        for k in 0..PANEL {
            for a in 0..ROWS {
                for b in 0..PANEL {
                    tile[a][b] = multiply_add::<FUSED>(x[a].0[k], steps[k][b], tile[a][b]);
                }
            }
        }
        for (row, values) in rows.iter_mut().zip(tile) {
            row.0 = values;
        }
    }
}

#[cfg(test)]
mod tests;
