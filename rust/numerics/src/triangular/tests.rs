//! Tests of the parent module.

use super::*;
use proptest::prelude::*;

/// Whole numbers up to 1000 in magnitude, of which products and their sums are exact.
fn whole_numbers(seed: u64, count: usize) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1);
        (state >> 33) % 2001
    };
    (0..count).map(|_| next() as f64 - 1000.0).collect()
}

/// A'A of a row-major table.
fn gram(table: &[f64], columns: usize) -> Vec<f64> {
    let mut sums = vec![0.0; columns * columns];
    for row in table.chunks_exact(columns) {
        for (sums, a) in sums.chunks_exact_mut(columns).zip(row) {
            sums.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
        }
    }
    sums
}

/// Largest entry of R'R - `products` relative to the norms of both columns, whose squares are on the
/// diagonal of `squares`. Asserts that R is triangular.
fn product_error(r: &[f64], products: &[f64], squares: &[f64], columns: usize) -> f64 {
    let actual = gram(r, columns);
    let norm = |i: usize| squares[i * columns + i].sqrt().max(f64::MIN_POSITIVE);
    let places = (0..columns).flat_map(|i| (0..columns).map(move |j| (i, j)));
    let errors = places.map(|(i, j)| {
        let at = i * columns + j;
        assert!(j >= i || r[at] == 0.0);
        (actual[at] - products[at]).abs() / norm(i) / norm(j)
    });
    errors.fold(0.0, f64::max)
}

/// R by one Householder reflection of all rows for each column.
fn plain_factor(table: &[f64], columns: usize) -> Vec<f64> {
    let mut a: Vec<Vec<f64>> = table.chunks_exact(columns).map(<[f64]>::to_vec).collect();
    for j in 0..columns {
        let norm = a[j..].iter().map(|row| row[j] * row[j]).sum::<f64>().sqrt();
        let mut v: Vec<f64> = a[j..].iter().map(|row| row[j]).collect();
        v[0] += norm.copysign(v[0]);
        let square: f64 = v.iter().map(|x| x * x).sum();
        for k in j..columns {
            let along: f64 = v.iter().zip(&a[j..]).map(|(x, row)| x * row[k]).sum();
            let rows = a[j..].iter_mut().zip(&v);
            rows.for_each(|(row, x)| row[k] -= 2.0 * along / square * x);
        }
    }
    a[..columns].concat()
}

proptest! {
    /// R'R = A'A to rounding, for columns of any size, zero columns, equal columns and few rows.
    #[test]
    fn factor_has_the_products_of_the_table(
        seed: u64,
        rows in 0..700_usize,
        columns in 1..45_usize,
        zero in 0..60_usize,
        copy in 1..60_usize,
    ) {
        let mut table = whole_numbers(seed, rows * columns);
        for row in table.chunks_exact_mut(columns) {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry *= 2.0_f64.powi((j * 7 % 40) as i32 - 20);
            }
            if zero < columns {
                row[zero] = 0.0;
            }
            if copy < columns {
                row[copy] = row[copy - 1];
            }
        }
        let products = gram(&table, columns);
        let error = product_error(&factor(&table, columns), &products, &products, columns);
        prop_assert!(error < 4e-15, "{error:e}");
    }

    /// The same matrix as that of one reflection per column, but for the sign of each row.
    #[test]
    fn agrees_with_one_reflection_per_column(
        seed: u64,
        rows in 100..500_usize,
        columns in 1..30_usize,
    ) {
        let table = whole_numbers(seed, rows * columns);
        let (actual, expected) = (factor(&table, columns), plain_factor(&table, columns));
        let size = (rows as f64).sqrt() * 1000.0;
        for (i, (actual, expected)) in actual.iter().zip(&expected).enumerate() {
            if i % columns >= i / columns {
                prop_assert!((actual.abs() - expected.abs()).abs() < 1e-14 * size);
            }
        }
    }

    /// Weighted means are subtracted from the rows of channels with a bias.
    #[test]
    fn weighted_rows_have_no_constant(seed: u64, samples in 1..80_usize, biased in 0..4_usize) {
        const CHANNELS: usize = 3;
        const UNKNOWNS: usize = 9;
        const FIRST: usize = 4; // of them are apart
        let columns = whole_numbers(seed, samples * CHANNELS * UNKNOWNS);
        let residual = whole_numbers(seed ^ 1, samples * CHANNELS);
        let mut scale = whole_numbers(seed ^ 2, samples * CHANNELS);
        // a channel without counted rows
        scale.chunks_exact_mut(CHANNELS).for_each(|row| row[1] = 0.0);
        let biased: Vec<usize> = (0..biased).collect();
        let mut table = Vec::new();
        for (at, row) in columns.chunks_exact(UNKNOWNS).enumerate() {
            table.extend(row.iter().map(|entry| entry * scale[at]));
            table.push(residual[at]);
        }
        const N: usize = UNKNOWNS + 1;
        let squares = gram(&table, N);
        for &channel in &biased {
            let rows = || (channel..samples * CHANNELS).step_by(CHANNELS);
            let power: f64 = rows().map(|at| scale[at] * scale[at]).sum();
            for k in (0..N).filter(|_| power > 0.0) {
                let along: f64 = rows().map(|at| scale[at] * table[at * N + k]).sum();
                rows().for_each(|at| table[at * N + k] -= scale[at] * along / power);
            }
        }
        let part = |range: std::ops::Range<usize>| -> Vec<f64> {
            columns.chunks_exact(UNKNOWNS).flat_map(|row| row[range.clone()].to_vec()).collect()
        };
        let (first, others) = (part(0..FIRST), part(FIRST..UNKNOWNS));
        let parts = [
            Columns { values: &first, unknowns: FIRST },
            Columns { values: &others, unknowns: UNKNOWNS - FIRST },
        ];
        let rows = WeightedRows {
            columns: &parts,
            scale: &scale,
            residual: &residual,
            channels: CHANNELS,
        };
        let error = product_error(&rows.factor(&biased), &gram(&table, N), &squares, N);
        prop_assert!(error < 1e-14, "{error:e}");
    }
}

#[test]
fn wide_tables_have_the_same_accuracy() {
    for columns in [95, 300] {
        let table = whole_numbers(1, 2500 * columns);
        let products = gram(&table, columns);
        let error = product_error(&factor(&table, columns), &products, &products, columns);
        assert!(error < 4e-15, "{error:e}");
    }
}

#[test]
fn small_difference_of_columns_is_accurate() {
    // the square of the difference is below rounding
    let (first, noise) = (whole_numbers(2, 2000), whole_numbers(3, 2000));
    let step = 2.0_f64.powi(-33);
    let pairs = first.iter().zip(&noise);
    let table: Vec<f64> = pairs.flat_map(|(a, b)| [*a, a + step * b]).collect();
    let (aa, ab, bb) = first
        .iter()
        .zip(&noise)
        .fold((0.0, 0.0, 0.0), |(aa, ab, bb), (a, b)| {
            (aa + a * a, ab + a * b, bb + b * b)
        });
    let (actual, expected) = (
        factor(&table, 2)[3].abs(),
        step * (bb - ab * ab / aa).sqrt(),
    );
    assert!(
        (actual / expected - 1.0).abs() < 1e-5,
        "{actual} {expected}"
    );
}

#[test]
fn column_without_size_changes_nothing() {
    // squares of the second column underflow
    let numbers = whole_numbers(4, 3 * 250);
    let with = |size: f64| {
        let mut table = numbers.clone();
        table.chunks_exact_mut(3).for_each(|row| row[1] *= size);
        factor(&table, 3)
    };
    let (tiny, zero) = (with(1e-160), with(0.0));
    assert_eq!(zero[4], 0.0);
    assert_eq!(zero[3..6], [0.0; 3]);
    for (a, b) in tiny.iter().zip(zero) {
        assert!((a - b).abs() < 1e-150);
    }
}

#[test]
fn entries_that_are_not_finite_show() {
    for value in [f64::NAN, f64::INFINITY] {
        let mut table = whole_numbers(5, 400 * 3);
        table[1] = value;
        let r = factor(&table, 3);
        assert!(r[0].is_finite() && !r[4].is_finite() && !r[8].is_finite());
    }
}

#[test]
fn plain_and_fused_agree() {
    let table = whole_numbers(6, BLOCK * 20);
    let filled = || {
        let mut factor = TriangularFactor::new(20);
        table[20..].chunks_exact(20).for_each(|row| factor.add(row));
        factor.block[BLOCK - 1] = ZERO_ROW;
        factor.rows = BLOCK;
        factor
    };
    let (mut plain, mut best) = (filled(), filled());
    plain.reduce_with::<false, { TILE_ROWS[0] }, { TILE_REFLECTIONS[0] }>();
    best.reduce();
    for (a, b) in plain.finish().iter().zip(best.finish()) {
        assert!((a - b).abs() < 1e-9);
    }
}
