//! Weighted equations without local unknowns, their triangular factor and their leverages.

use crate::elimination::{Windows, eliminate};
use crate::triangular::TriangularFactor;

/// Smallest diagonal entry of a factor, relative to the largest, whose unknown has leverage.
const MIN_PIVOT: f64 = 1e-10;

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

/// Columns of a table: common unknowns of unit standard deviation, parameters, targets.
#[derive(Clone, Copy, Debug)]
pub struct Widths {
    /// Number of common unknowns.
    pub common: usize,
    /// Number of parameters.
    pub parameters: usize,
    /// Number of all columns.
    pub all: usize,
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

/// Reduces the rows of a table, multiplied by `root`.
///
/// Returns `None` if an entry is not finite.
pub fn reduce(table: &[f64], root: &[f64], widths: Widths, parts: &[Part<'_>]) -> Option<Reduced> {
    let (n, stop) = (widths.all, widths.common + widths.parameters);
    let mut own: Vec<f64> = (table.chunks_exact(n).zip(root))
        .flat_map(|(row, weight)| row.iter().map(move |value| value * weight))
        .collect();
    let mut squares = vec![0.0; n];
    for row in own.chunks_exact(n) {
        for (square, value) in squares.iter_mut().zip(row) {
            *square += value * value;
        }
    }
    let norm = |square: &f64| if *square > 0.0 { square.sqrt() } else { 1.0 };
    let scale: Vec<f64> = squares[widths.common..stop].iter().map(norm).collect();
    for row in own.chunks_exact_mut(n) {
        for (value, scale) in row[widths.common..stop].iter_mut().zip(&scale) {
            *value /= scale;
        }
    }
    let mut leverage = vec![0.0; root.len()];
    let mut below = Vec::new();
    for part in parts {
        let Windows {
            first,
            width,
            unknowns,
            ..
        } = part.windows;
        let mut entries = part.windows.entries.to_vec();
        if width == 0 {
            below.resize(below.len() + unknowns * n, 0.0);
            continue;
        }
        for ((row, &first), window) in part.rows.iter().zip(first).zip(entries.chunks_mut(width)) {
            for (value, std) in window.iter_mut().zip(&part.stds[first.min(unknowns)..]) {
                *value *= root[*row] * std;
            }
        }
        let windows = Windows {
            entries: &entries,
            ..part.windows
        };
        let row_of = |row: &usize| own[row * n..][..n].to_vec();
        let right: Vec<f64> = part.rows.iter().flat_map(row_of).collect();
        let rest = eliminate(windows, &right, n)?;
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
    for k in 0..widths.common {
        let mut prior = vec![0.0; n];
        prior[k] = 1.0;
        factor.add(&prior);
    }
    let factor = factor.finish();
    for (row, leverage) in own.chunks_exact(n).zip(&mut leverage) {
        *leverage += squared_solution(&factor, n, &row[..stop]);
    }
    Some(Reduced {
        scale,
        own,
        below,
        leverage,
        factor,
    })
}

/// Sum of squares of q in q R = a, for the leading block of R and without negligible pivots.
fn squared_solution(factor: &[f64], n: usize, a: &[f64]) -> f64 {
    let pivot = |k: usize| factor[k * n + k].abs();
    let least = MIN_PIVOT * (0..a.len()).map(pivot).fold(0.0, f64::max);
    let mut rest = a.to_vec();
    let mut total = 0.0;
    for k in 0..a.len() {
        if pivot(k) > least {
            let q = rest[k] / factor[k * n + k];
            total += q * q;
            for j in k + 1..a.len() {
                rest[j] -= q * factor[k * n + j];
            }
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The factor R and the leverages of the dense problem [Z S, table; I, 0; 0, I 0].
        #[test]
        fn agrees_with_dense_equations(seed in prop::collection::vec(-1.0..1.0f64, 60)) {
            let (rows, widths) = (9, Widths { common: 1, parameters: 2, all: 4 });
            let table = &seed[..rows * 4];
            let root: Vec<f64> = seed[36..45].iter().map(|value| 1.5 + value).collect();
            let first = [0, 0, 1, 1, 2];
            let windows = Windows { first: &first, entries: &seed[45..55], width: 2, unknowns: 4 };
            let stds = [0.5, 2.0, 1.0, 0.7];
            let at = [1, 2, 4, 5, 8];
            let part = Part { rows: &at, windows, stds: &stds };
            let reduced = reduce(table, &root, widths, &[part]).unwrap();
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
            for (values, leverage) in all.iter().zip(&reduced.leverage) {
                let dense = squared_solution(&expected, 8, &values[..7]);
                prop_assert!((leverage - dense).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_repeated_column_adds_no_leverage() {
        let table = [1.0, 1.0, 0.0, 2.0, 2.0, 1.0, 2.0, 2.0, 0.0];
        let widths = Widths {
            common: 0,
            parameters: 2,
            all: 3,
        };
        let reduced = reduce(&table, &[1.0; 3], widths, &[]).unwrap();
        for (leverage, expected) in reduced.leverage.iter().zip([1.0, 4.0, 4.0]) {
            assert!((leverage - expected / 9.0).abs() < 1e-12);
        }
    }
}
