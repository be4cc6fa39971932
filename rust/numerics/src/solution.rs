//! Solution of weighted equations with common and local unknowns, and its robust weights.

use crate::reduction::{Equations, Reduced, reduce};
use crate::singular;

/// Smallest ratio of a singular value to the noise of the regressor in its direction.
const MIN_SINGULAR_VALUE_TO_NOISE: f64 = 3.0;
/// Smallest ratio of a singular value to the largest one: below, it is rounding.
const MIN_SINGULAR_VALUE: f64 = 1e-10;
/// Huber limit, in standard deviations. It reduces the influence of gross errors only. A lower limit
/// would cut the heavy tails of friction residuals on one side of each velocity reversal.
const HUBER_LIMIT_STDS: f64 = 4.0;
/// Smallest share of its error that remains in a residual used for the scale estimate.
const MIN_RESIDUAL_SHARE: f64 = 0.2;
/// Smallest standard deviation as a share of the rms target: residuals of an exact model are
/// rounding errors.
const MIN_STD_SHARE: f64 = 1e-6;

/// Solution of one weighted least-squares problem, and its singular value decomposition.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Parameters (parameters, sides), of least norm in the scaled parameters if not unique.
    pub value: Vec<f64>,
    /// Common unknowns, (common unknowns, sides).
    pub common: Vec<f64>,
    /// Local unknowns, (local unknowns, sides).
    pub local: Vec<f64>,
    /// Norms of the weighted columns of the parameters.
    pub scale: Vec<f64>,
    /// Singular values of the weighted, column-scaled regressor, descending.
    pub singular: Vec<f64>,
    /// Its right singular vectors, one per row.
    pub directions: Vec<f64>,
    /// Whether the singular value of a direction exceeds the noise of the regressor.
    pub resolved: Vec<bool>,
    /// Diagonal of the hat matrix.
    pub leverage: Vec<f64>,
    /// Residuals (rows, sides) of the equations.
    pub residual: Vec<f64>,
}

/// Solves weighted equations; `noise` is the rms noise in the regressor of each parameter.
///
/// Directions that the noise hides are left out. Returns `None` if an entry is not finite.
pub fn solve(equations: Equations<'_>, noise: &[f64]) -> Option<Solution> {
    let Reduced {
        scale,
        own,
        below,
        leverage,
        factor,
    } = reduce(equations)?;
    let (common, stop) = (equations.common_stds.len(), equations.unknowns());
    let (p, sides, n) = (equations.parameters, equations.sides, equations.columns());
    if !factor.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let rows = || factor.chunks_exact(n);
    let of_parameters = || rows().skip(common).take(p);
    let block: Vec<f64> = of_parameters()
        .flat_map(|row| row[common..stop].iter().copied())
        .collect();
    let right: Vec<f64> = of_parameters()
        .flat_map(|row| row[stop..].iter().copied())
        .collect();
    let parts = singular::decompose(&block, p, &right);
    let power: f64 = equations.root.iter().map(|root| root * root).sum();
    let is_resolved = |(direction, &value): (&[f64], &f64)| {
        let share = |((x, noise), scale): ((&f64, &f64), &f64)| (x * noise / scale).powi(2);
        let noise: f64 = direction.iter().zip(noise).zip(&scale).map(share).sum();
        let hidden = MIN_SINGULAR_VALUE_TO_NOISE * (power * noise).sqrt();
        value > hidden.max(MIN_SINGULAR_VALUE * parts.values[0])
    };
    let directions = parts.right.chunks_exact(p.max(1));
    let resolved: Vec<bool> = directions
        .clone()
        .zip(&parts.values)
        .map(is_resolved)
        .collect();
    // common unknowns in units of their standard deviations, then scaled parameters
    let mut unknowns = vec![0.0; stop * sides];
    for (k, direction) in directions.enumerate().filter(|(k, _)| resolved[*k]) {
        for (x, weight) in unknowns[common * sides..]
            .chunks_exact_mut(sides)
            .zip(direction)
        {
            for (x, left) in x.iter_mut().zip(&parts.left[k * sides..]) {
                *x += weight * left / parts.values[k];
            }
        }
    }
    for k in (0..common).rev() {
        let row = &factor[k * n..][..n];
        for side in 0..sides {
            let known = |j: usize| row[j] * unknowns[j * sides + side];
            let sum: f64 = (k + 1..stop).map(known).sum();
            unknowns[k * sides + side] = (row[stop + side] - sum) / row[k];
        }
    }
    let rest = |row: &[f64], side: usize| -> f64 {
        let explained = (0..stop).map(|j| row[j] * unknowns[j * sides + side]);
        row[stop + side] - explained.sum::<f64>()
    };
    let rests = |rows: &[f64], scale: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let rows = rows.chunks_exact(n.max(1)).enumerate();
        rows.flat_map(|(k, row)| {
            let scale = scale(k);
            (0..sides).map(move |side| (row, side, scale))
        })
        .map(|(row, side, scale)| rest(row, side) * scale)
        .collect()
    };
    let stds: Vec<f64> = equations
        .parts
        .iter()
        .flat_map(|part| part.stds)
        .copied()
        .collect();
    let local = rests(&below, &|k| stds[k]);
    let residual = rests(&own, &|k| 1.0 / equations.root[k]);
    for (x, factor) in unknowns
        .chunks_exact_mut(sides.max(1))
        .zip((equations.common_stds.iter().copied()).chain(scale.iter().map(|scale| 1.0 / scale)))
    {
        x.iter_mut().for_each(|x| *x *= factor);
    }
    let value = unknowns.split_off(common * sides);
    Some(Solution {
        value,
        common: unknowns,
        local,
        scale,
        singular: parts.values,
        directions: parts.right,
        resolved,
        leverage,
        residual,
    })
}

/// Square roots of Huber's weights of residuals, with a robust standard deviation for each group.
///
/// w = min(1, HUBER_LIMIT_STDS / |r / s|) / s^2, with the leverage h and
/// s = `std_per_median` median |r / sqrt(1 - h)|. Rows with a negative group keep the weight 1.
pub fn huber_roots(
    residual: &[f64],
    leverage: &[f64],
    target: &[f64],
    group: &[i64],
    std_per_median: f64,
) -> Vec<f64> {
    let mut roots = vec![1.0; residual.len()];
    let mut groups: Vec<i64> = group.iter().copied().filter(|group| *group >= 0).collect();
    groups.sort_unstable();
    groups.dedup();
    for each in groups {
        let rows = || (0..residual.len()).filter(|&row| group[row] == each);
        let share = |row: usize| (1.0 - leverage[row]).max(MIN_RESIDUAL_SHARE);
        let corrected = |row: usize| residual[row].abs() / share(row).sqrt();
        let informative = rows().filter(|&row| share(row) > MIN_RESIDUAL_SHARE);
        let mut sizes: Vec<f64> = informative.map(corrected).collect();
        if sizes.is_empty() {
            sizes = rows().map(corrected).collect();
        }
        let (count, power) = rows().fold((0.0, 0.0), |(count, power), row| {
            (count + 1.0, power + target[row] * target[row])
        });
        let least = (MIN_STD_SHARE * f64::sqrt(power / count)).max(f64::MIN_POSITIVE);
        let std = (std_per_median * median(&mut sizes)).max(least);
        let limit = HUBER_LIMIT_STDS * std;
        for row in rows() {
            roots[row] = (limit / residual[row].abs().max(limit)).sqrt() / std;
        }
    }
    roots
}

/// Median of at least one number; the numbers are put in another order.
fn median(numbers: &mut [f64]) -> f64 {
    let middle = numbers.len() / 2;
    let (below, &mut upper, _) = numbers.select_nth_unstable_by(middle, f64::total_cmp);
    let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    match numbers.len() % 2 {
        1 => upper,
        _ => 0.5 * (lower + upper),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Weighted residuals and priors are orthogonal to all regressors.
        #[test]
        fn satisfies_the_normal_equations(seed in prop::collection::vec(-1.0..1.0f64, 60)) {
            let (rows, sides) = (12, 2);
            let root: Vec<f64> = seed[..rows].iter().map(|value| 1.5 + value).collect();
            let (common, shared) = (&seed[12..24], &seed[24..48]);
            let targets: Vec<f64> = seed.iter().cycle().skip(30).step_by(7).take(24).copied().collect();
            let equations = Equations {
                common,
                common_stds: &[0.7],
                shared,
                parameters: 2,
                targets: &targets,
                sides,
                root: &root,
                parts: &[],
            };
            let solution = solve(equations, &[0.0; 2]).unwrap();
            prop_assume!(solution.singular[1] > 1e-2);
            for side in 0..sides {
                let moment = |regressor: &dyn Fn(usize) -> f64| -> f64 {
                    (0..rows)
                        .map(|row| {
                            let residual = solution.residual[row * sides + side];
                            root[row] * root[row] * regressor(row) * residual
                        })
                        .sum()
                };
                for k in 0..2 {
                    prop_assert!(moment(&|row| shared[2 * row + k]).abs() < 1e-9);
                }
                let prior = solution.common[side] / (0.7 * 0.7);
                prop_assert!((moment(&|row| common[row]) - prior).abs() < 1e-9);
            }
        }

        /// Weights do not change if residuals have another unit, except for that unit.
        #[test]
        fn weights_scale_with_residuals(residual in prop::collection::vec(-1.0..1.0f64, 12)) {
            prop_assume!(residual.iter().all(|each| each.abs() > 1e-3));
            let group = [0, 0, 0, 0, 0, 0, 3, 3, 3, 3, -1, -1];
            let leverage: Vec<f64> = residual.iter().map(|each| each.abs()).collect();
            let doubled: Vec<f64> = residual.iter().map(|each| 2.0 * each).collect();
            let of = |residual: &[f64]| huber_roots(residual, &leverage, &[0.1; 12], &group, 1.5);
            for (k, (one, other)) in of(&residual).iter().zip(of(&doubled)).enumerate() {
                let expected = if k < 10 { one / 2.0 } else { 1.0 };
                prop_assert!((other - expected).abs() < 1e-12 * expected);
            }
        }
    }

    #[test]
    fn medians_are_those_of_sorted_numbers() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0, 4.0]), 2.5);
    }

    #[test]
    fn an_outlier_has_less_weight() {
        let residual = [1.0, -1.0, 1.0, -1.0, 40.0];
        let roots = huber_roots(&residual, &[0.0; 5], &[1.0; 5], &[0; 5], 1.0);
        assert_eq!(roots[..4], [1.0; 4]);
        assert!((roots[4] * roots[4] - HUBER_LIMIT_STDS / 40.0).abs() < 1e-15);
    }
}
