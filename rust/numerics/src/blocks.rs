//! Normal equations of weighted equations without their local unknowns, block of rows by block.
//!
//! A delete-one-block jackknife needs the normal equations without each block. Without the block,
//! the local unknowns that occur in it have other estimates.

use crate::elimination::{Windows, residual_products_without_blocks};
use crate::products::{BASELINE_IS_FUSED, multiply_add};
use crate::reduction::Equations;

/// Products of all columns, each (columns, columns).
#[derive(Clone, Debug, PartialEq)]
pub struct BlockProducts {
    /// Sum over all rows and priors.
    pub total: Vec<f64>,
    /// Contribution of each block, one after the other.
    pub blocks: Vec<f64>,
    /// Sum over the errors of the priors, which have unit variance.
    pub priors: Vec<f64>,
}

/// Products of the columns without the local unknowns.
///
/// `block` has the block of each row, less than `count`, or `None` for a prior. Returns `None` if an
/// entry of the local regressors is not finite. Panics if a row of a local unknown is a prior.
pub fn block_products(
    equations: Equations<'_>,
    block: &[Option<usize>],
    count: usize,
) -> Option<BlockProducts> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: both features have just been detected.
        return unsafe { block_products_avx2(equations, block, count) };
    }
    block_products_with::<BASELINE_IS_FUSED>(equations, block, count)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn block_products_avx2(
    equations: Equations<'_>,
    block: &[Option<usize>],
    count: usize,
) -> Option<BlockProducts> {
    block_products_with::<true>(equations, block, count)
}

#[inline(always)]
fn block_products_with<const FUSED: bool>(
    equations: Equations<'_>,
    block: &[Option<usize>],
    count: usize,
) -> Option<BlockProducts> {
    let (n, common) = (equations.columns(), equations.common_stds.len());
    let rows = equations.weighted_rows();
    let row_of = |row: usize| &rows[row * n..][..n];
    let mut sums = BlockProducts {
        total: vec![0.0; n * n],
        blocks: vec![0.0; count * n * n],
        priors: vec![0.0; n * n],
    };
    let mut is_local = vec![false; block.len()];
    for part in equations.parts.iter().filter(|part| part.windows.width > 0) {
        let block_of = |k: usize| block[part.rows[k]].expect("a block");
        let mut order: Vec<usize> = (0..part.rows.len()).collect();
        order.sort_by_key(|&k| block_of(k));
        let stops: Vec<usize> = (0..count)
            .map(|each| order.partition_point(|&k| block_of(k) <= each))
            .collect();
        let (unordered, width) = (part.weighted_entries(equations.root), part.windows.width);
        let mut first = Vec::with_capacity(order.len());
        let mut entries = Vec::with_capacity(unordered.len());
        let mut right = Vec::with_capacity(order.len() * n);
        for &k in &order {
            first.push(part.windows.first[k]);
            entries.extend_from_slice(&unordered[k * width..][..width]);
            right.extend_from_slice(row_of(part.rows[k]));
            is_local[part.rows[k]] = true;
        }
        let windows = Windows {
            first: &first,
            entries: &entries,
            ..part.windows
        };
        let products = residual_products_without_blocks::<FUSED>(windows, &right, n, &stops)?;
        for (sum, value) in sums.total.iter_mut().zip(&products.total) {
            *sum += value;
        }
        for (block, without) in sums.blocks.chunks_exact_mut(n * n).zip(&products.without) {
            for ((sum, total), without) in block.iter_mut().zip(&products.total).zip(without) {
                *sum += total - without;
            }
        }
        for solution in products.solution.chunks_exact(n) {
            add_square::<FUSED>(&mut sums.priors, solution);
        }
    }
    for row in (0..block.len()).filter(|&row| !is_local[row]) {
        let target = match block[row] {
            Some(block) => &mut sums.blocks[block * n * n..][..n * n],
            None => &mut sums.priors,
        };
        add_square::<FUSED>(target, row_of(row));
        add_square::<FUSED>(&mut sums.total, row_of(row));
    }
    for k in 0..common {
        sums.total[k * (n + 1)] += 1.0;
        sums.priors[k * (n + 1)] += 1.0;
    }
    Some(sums)
}

/// Adds y'y to a square matrix.
#[inline(always)]
fn add_square<const FUSED: bool>(target: &mut [f64], y: &[f64]) {
    for (row, &value) in target.chunks_exact_mut(y.len()).zip(y) {
        for (target, other) in row.iter_mut().zip(y) {
            *target = multiply_add::<FUSED>(value, *other, *target);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduction::{Part, reduce};
    use proptest::prelude::*;

    /// Rows of three blocks, a row without local unknowns in one of them, and a prior.
    const BLOCK: [Option<usize>; 8] = [
        Some(0),
        Some(0),
        Some(1),
        Some(1),
        Some(2),
        Some(2),
        Some(1),
        None,
    ];

    /// R'R of the rows that are kept.
    fn products(seed: &[f64], is_kept: impl Fn(usize) -> bool) -> Vec<f64> {
        let weighted = |row: usize| if is_kept(row) { 1.0 + row as f64 } else { 0.0 };
        let root: Vec<f64> = (0..8).map(weighted).collect();
        let mut reduced = Vec::new();
        with_equations(seed, &root, |equations| {
            let Equations { parameters, .. } = equations;
            let reduction = reduce(equations).unwrap();
            let n = equations.columns();
            let scale = |k: usize| match k.checked_sub(1) {
                Some(k) if k < parameters => reduction.scale[k],
                _ => 1.0,
            };
            for i in 0..n {
                for j in 0..n {
                    let product =
                        |k: usize| reduction.factor[k * n + i] * reduction.factor[k * n + j];
                    let sum: f64 = (0..n).map(product).sum();
                    reduced.push(sum * scale(i) * scale(j));
                }
            }
        });
        reduced
    }

    /// Equations with a common unknown, two parameters, a target and four local unknowns.
    fn with_equations(seed: &[f64], root: &[f64], mut act: impl FnMut(Equations<'_>)) {
        let windows = Windows {
            first: &[2, 0, 1, 0, 2, 1],
            entries: &seed[..12],
            width: 2,
            unknowns: 4,
        };
        let part = Part {
            rows: &[4, 0, 2, 1, 5, 3],
            windows,
            stds: &[1.0, 0.5, 2.0, 0.7],
        };
        act(Equations {
            common: &seed[12..20],
            common_stds: &[0.8],
            shared: &seed[20..36],
            parameters: 2,
            targets: &seed[36..44],
            sides: 1,
            root,
            parts: &[part],
        });
    }

    proptest! {
        /// The products without a block are those of the other rows, whose factor is R.
        #[test]
        fn blocks_contribute_what_their_absence_changes(
            seed in prop::collection::vec(-1.0..1.0f64, 44),
        ) {
            let root: Vec<f64> = (0..8).map(|row| 1.0 + row as f64).collect();
            let all = products(&seed, |_| true);
            let mut sums = None;
            with_equations(&seed, &root, |equations| sums = block_products(equations, &BLOCK, 3));
            let sums = sums.unwrap();
            for (total, expected) in sums.total.iter().zip(&all) {
                prop_assert!((total - expected).abs() < 1e-9);
            }
            for (block, contribution) in sums.blocks.chunks_exact(16).enumerate() {
                let others = products(&seed, |row| BLOCK[row] != Some(block));
                for ((all, others), contribution) in all.iter().zip(others).zip(contribution) {
                    prop_assert!((all - others - contribution).abs() < 1e-9);
                }
            }
        }
    }
}
