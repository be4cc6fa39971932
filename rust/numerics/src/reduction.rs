//! Weighted equations without local unknowns, their triangular factor and their leverages.

use crate::elimination::{Windows, eliminate};
use crate::products::{multiply_add, with_vectors};
use crate::triangular::TriangularFactor;

/// Smallest diagonal entry of a factor, relative to the largest, whose unknown has leverage.
const MIN_PIVOT: f64 = 1e-10;

/// Rows whose leverages are computed together.
const LANES: usize = 8;

/// Equations of local unknowns: rows of a table, in the order of the windows.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// Rows of the table, distinct from those of other parts.
    pub rows: &'a [usize],
    /// Regressors of the unknowns.
    pub windows: Windows<'a>,
    /// Standard deviations of the unknowns.
    pub stds: &'a [f64],
}

/// Weighted equations: common unknowns, parameters and local unknowns explain the targets.
///
/// The common and the local unknowns have zero mean and known standard deviations.
#[derive(Clone, Copy, Debug)]
pub struct Equations<'a> {
    /// Regressors of the common unknowns, (rows, common unknowns).
    pub common: &'a [f64],
    /// Standard deviations of the common unknowns.
    pub common_stds: &'a [f64],
    /// Regressors of the parameters, (rows, parameters).
    pub shared: &'a [f64],
    /// Number of parameters.
    pub parameters: usize,
    /// Right-hand sides, (rows, targets).
    pub targets: &'a [f64],
    /// Number of right-hand sides.
    pub sides: usize,
    /// Square roots of the weights of the rows.
    pub root: &'a [f64],
    /// Equations of the local unknowns.
    pub parts: &'a [Part<'a>],
}

impl Equations<'_> {
    /// Number of common unknowns and parameters.
    pub fn unknowns(self) -> usize {
        self.common_stds.len() + self.parameters
    }

    /// Number of columns: unknowns, then targets.
    pub fn columns(self) -> usize {
        self.unknowns() + self.sides
    }

    /// Weighted rows (rows, columns), with common unknowns in units of their standard deviations.
    #[inline(always)]
    pub(crate) fn weighted_rows(self) -> Vec<f64> {
        let (n, common) = (self.columns(), self.common_stds.len());
        let mut rows = vec![0.0; self.root.len() * n];
        for (at, (row, &root)) in rows.chunks_exact_mut(n).zip(self.root).enumerate() {
            let (of_common, rest) = row.split_at_mut(common);
            let (of_parameters, of_targets) = rest.split_at_mut(self.parameters);
            let source = &self.common[at * common..];
            for ((value, x), std) in of_common.iter_mut().zip(source).zip(self.common_stds) {
                *value = x * std * root;
            }
            for (value, x) in of_parameters
                .iter_mut()
                .zip(&self.shared[at * self.parameters..])
            {
                *value = x * root;
            }
            for (value, x) in of_targets.iter_mut().zip(&self.targets[at * self.sides..]) {
                *value = x * root;
            }
        }
        rows
    }
}

impl Part<'_> {
    /// Entries of the windows, weighted, for unknowns of unit standard deviation.
    #[inline(always)]
    pub(crate) fn weighted_entries(self, root: &[f64]) -> Vec<f64> {
        let Windows { first, width, .. } = self.windows;
        let mut entries = self.windows.entries.to_vec();
        for ((row, &first), window) in self.rows.iter().zip(first).zip(entries.chunks_mut(width)) {
            for (value, std) in window
                .iter_mut()
                .zip(&self.stds[first.min(self.stds.len())..])
            {
                *value *= root[*row] * std;
            }
        }
        entries
    }
}

/// Rows after elimination of the local unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct Reduced {
    /// Norms of the weighted columns of the parameters; 1 for zero columns.
    pub scale: Vec<f64>,
    /// Weighted rows, with scaled parameters.
    pub own: Vec<f64>,
    /// Regression of each column on the local regressors, (local unknowns, columns).
    pub below: Vec<f64>,
    /// Diagonal of the hat matrix of all unknowns.
    pub leverage: Vec<f64>,
    /// Triangular factor of all rows, those of the priors included.
    pub factor: Vec<f64>,
}

/// Eliminates the local unknowns part by part, and factorises the rest.
///
/// Returns `None` if an entry of the local regressors is not finite.
pub fn reduce(equations: Equations<'_>) -> Option<Reduced> {
    with_vectors!(reduce_with(equations: Equations<'_>) -> Option<Reduced>)
}

#[inline(always)]
fn reduce_with<const FUSED: bool>(equations: Equations<'_>) -> Option<Reduced> {
    let (common, stop, n) = (
        equations.common_stds.len(),
        equations.unknowns(),
        equations.columns(),
    );
    let mut own = equations.weighted_rows();
    let mut scale = vec![0.0; stop - common];
    for row in own.chunks_exact(n) {
        for (square, value) in scale.iter_mut().zip(&row[common..]) {
            *square += value * value;
        }
    }
    for square in &mut scale {
        *square = if *square > 0.0 { square.sqrt() } else { 1.0 };
    }
    for row in own.chunks_exact_mut(n) {
        for (value, scale) in row[common..].iter_mut().zip(&scale) {
            *value /= scale;
        }
    }
    let mut leverage = vec![0.0; equations.root.len()];
    let mut below = Vec::new();
    for part in equations.parts {
        if part.windows.width == 0 {
            below.resize(below.len() + part.windows.unknowns * n, 0.0);
            continue;
        }
        let entries = part.weighted_entries(equations.root);
        let windows = Windows {
            entries: &entries,
            ..part.windows
        };
        let mut right = Vec::with_capacity(part.rows.len() * n);
        for &row in part.rows {
            right.extend_from_slice(&own[row * n..][..n]);
        }
        let rest = eliminate::<FUSED>(windows, &right, n)?;
        for (k, &row) in part.rows.iter().enumerate() {
            own[row * n..][..n].copy_from_slice(&rest.residuals[k * n..][..n]);
            leverage[row] = rest.leverage[k];
        }
        below.extend(rest.solution);
    }
    let mut factor = TriangularFactor::new(n);
    own.chunks_exact(n)
        .chain(below.chunks_exact(n))
        .for_each(|row| factor.add(row));
    let mut prior = vec![0.0; n];
    for k in 0..common {
        prior[k] = 1.0;
        factor.add(&prior);
        prior[k] = 0.0;
    }
    let factor = factor.finish();
    add_leverages::<FUSED>(&mut leverage, &factor, n, stop, &own);
    Some(Reduced {
        scale,
        own,
        below,
        leverage,
        factor,
    })
}

/// Adds the sum of squares of q in q R = a for each row a, without negligible pivots.
///
/// R is the leading block of `stop` columns of a factor, and a the beginning of a row.
#[inline(always)]
fn add_leverages<const FUSED: bool>(
    leverage: &mut [f64],
    factor: &[f64],
    n: usize,
    stop: usize,
    rows: &[f64],
) {
    let pivots: Vec<f64> = (0..stop).map(|k| factor[k * n + k]).collect();
    let largest = pivots.iter().fold(0.0, |most: f64, p| most.max(p.abs()));
    let mut rest = vec![[0.0; LANES]; stop];
    for (leverage, rows) in leverage.chunks_mut(LANES).zip(rows.chunks(LANES * n)) {
        for (lane, row) in rows.chunks_exact(n).enumerate() {
            for (rest, value) in rest.iter_mut().zip(row) {
                rest[lane] = *value;
            }
        }
        let mut total = [0.0; LANES];
        for k in 0..stop {
            if pivots[k].abs() > MIN_PIVOT * largest {
                let mut q = rest[k];
                for lane in 0..LANES {
                    q[lane] /= pivots[k];
                    total[lane] = multiply_add::<FUSED>(q[lane], q[lane], total[lane]);
                }
                for j in k + 1..stop {
                    let weight = -factor[k * n + j];
                    for lane in 0..LANES {
                        rest[j][lane] = multiply_add::<FUSED>(q[lane], weight, rest[j][lane]);
                    }
                }
            }
        }
        for (leverage, total) in leverage.iter_mut().zip(total) {
            *leverage += total;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The factor R and the leverages of the dense problem [Z S, table; I, 0; 0, I 0].
        #[test]
        fn agrees_with_dense_equations(seed in prop::collection::vec(-1.0..1.0f64, 60)) {
            let rows = 9;
            let table = &seed[..rows * 4];
            let root: Vec<f64> = seed[36..45].iter().map(|value| 1.5 + value).collect();
            let first = [0, 0, 1, 1, 2];
            let windows = Windows { first: &first, entries: &seed[45..55], width: 2, unknowns: 4 };
            let stds = [0.5, 2.0, 1.0, 0.7];
            let at = [1, 2, 4, 5, 8];
            let columns = |from: usize, to: usize| -> Vec<f64> {
                table.chunks_exact(4).flat_map(|row| row[from..to].to_vec()).collect()
            };
            let reduced = reduce(Equations {
                common: &columns(0, 1),
                common_stds: &[1.0],
                shared: &columns(1, 3),
                parameters: 2,
                targets: &columns(3, 4),
                sides: 1,
                root: &root,
                parts: &[Part { rows: &at, windows, stds: &stds }],
            })
            .unwrap();
            // dense rows: local unknowns first, then the columns of the table
            let mut dense = TriangularFactor::new(8);
            let mut all = Vec::new();
            for row in 0..rows {
                let mut values = vec![0.0; 4];
                if let Some(k) = at.iter().position(|&each| each == row) {
                    for j in 0..2 {
                        let entry = seed[45 + 2 * k + j];
                        values[first[k] + j] = root[row] * entry * stds[first[k] + j];
                    }
                }
                values.extend((0..4).map(|j| {
                    let scale = if (1..3).contains(&j) { reduced.scale[j - 1] } else { 1.0 };
                    table[row * 4 + j] * root[row] / scale
                }));
                dense.add(&values);
                all.push(values);
            }
            for k in 0..5 {
                let mut prior = vec![0.0; 8];
                prior[k] = 1.0;
                dense.add(&prior);
            }
            let expected = dense.finish();
            for i in 0..4 {
                for j in i..4 {
                    let (got, dense) = (reduced.factor[i * 4 + j], expected[(4 + i) * 8 + 4 + j]);
                    prop_assert!((got.abs() - dense.abs()).abs() < 1e-12);
                }
            }
            let mut leverage = vec![0.0; rows];
            for (values, leverage) in all.iter().zip(&mut leverage) {
                add_leverages::<false>(std::slice::from_mut(leverage), &expected, 8, 7, values);
            }
            for (leverage, dense) in reduced.leverage.iter().zip(leverage) {
                prop_assert!((leverage - dense).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_repeated_column_adds_no_leverage() {
        let reduced = reduce(Equations {
            common: &[],
            common_stds: &[],
            shared: &[1.0, 1.0, 2.0, 2.0, 2.0, 2.0],
            parameters: 2,
            targets: &[0.0, 1.0, 0.0],
            sides: 1,
            root: &[1.0; 3],
            parts: &[],
        })
        .unwrap();
        for (leverage, expected) in reduced.leverage.iter().zip([1.0, 4.0, 4.0]) {
            assert!((leverage - expected / 9.0).abs() < 1e-12);
        }
    }
}
