//! Tests of the parent module.

use super::*;

/// Number of right-hand sides.
const SIDES: usize = 3;

struct Example {
    first: Vec<usize>,
    entries: Vec<f64>,
    width: usize,
    unknowns: usize,
    y: Vec<f64>,
}

impl Example {
    /// Rows with a few unknowns each, one row without unknowns, and unknowns without rows.
    fn new() -> Self {
        let (rows, unknowns, width) = (42, 23, 9); // two rows more than whole groups of four
        let first: Vec<usize> = (0..rows).map(|row| row / 2).collect();
        let mut entries = vec![0.0; rows * width];
        for row in (0..rows).filter(|row| *row != 7) {
            for i in row / 2..(row / 2 + 5 + row % 4).min(unknowns - 2) {
                let entry = (row * 31 + i * 17) % 29;
                entries[row * width + i - first[row]] = entry as f64 - 14.0;
            }
        }
        let y = (0..rows * SIDES).map(|i| (i * 37 % 101) as f64 - 50.0);
        Self {
            y: y.collect(),
            first,
            entries,
            width,
            unknowns,
        }
    }

    fn windows(&self) -> Windows<'_> {
        Windows {
            first: &self.first,
            entries: &self.entries,
            width: self.width,
            unknowns: self.unknowns,
        }
    }

    fn at(&self, row: usize, i: usize) -> f64 {
        let place = i.checked_sub(self.first[row]).filter(|at| *at < self.width);
        place.map_or(0.0, |at| self.entries[row * self.width + at])
    }

    /// The same equations without a range of rows.
    fn without(&self, start: usize, stop: usize) -> Self {
        let cut =
            |list: &[f64], width: usize| [&list[..start * width], &list[stop * width..]].concat();
        Self {
            first: [&self.first[..start], &self.first[stop..]].concat(),
            entries: cut(&self.entries, self.width),
            y: cut(&self.y, SIDES),
            ..*self
        }
    }
}

#[test]
fn solves_the_normal_equations() {
    let example = Example::new();
    let elimination = eliminate::<false>(example.windows(), &example.y, SIDES).unwrap();
    for j in 0..SIDES {
        let column = |m: &[f64]| -> Vec<f64> { m.iter().skip(j).step_by(SIDES).copied().collect() };
        let (x, residuals) = (
            column(&elimination.solution),
            column(&elimination.residuals),
        );
        for (i, x) in x.iter().enumerate() {
            // G x = Z'y is equivalent to Z'(y - Z x) = x.
            let actual: f64 = (0..residuals.len())
                .map(|row| example.at(row, i) * residuals[row])
                .sum();
            assert!((actual - x).abs() < 1e-9, "{actual} {x}");
        }
    }
}

#[test]
fn leverage_is_projection_diagonal() {
    let example = Example::new();
    let rows = example.first.len();
    for row in [0, 7, 20, rows - 1] {
        let mut unit = vec![0.0; rows];
        unit[row] = 1.0;
        let elimination = eliminate::<false>(example.windows(), &unit, 1).unwrap();
        assert!((elimination.residuals[row] - (1.0 - elimination.leverage[row])).abs() < 1e-12);
    }
}

/// Compares with an elimination of the other rows alone: Y'(Y - Z G^-1 Z'Y).
#[test]
fn block_prediction_agrees_with_fit_without_block() {
    let example = Example::new();
    let rows = example.first.len();
    // long and short blocks, one of a single row without unknowns, one without rows
    let stops = [7, 8, 8, 10, 11, 25, rows];
    let actual =
        residual_products_without_blocks::<false>(example.windows(), &example.y, SIDES, &stops)
            .unwrap();
    let all = eliminate::<false>(example.windows(), &example.y, SIDES).unwrap();
    for (actual, expected) in actual.solution.iter().zip(all.solution) {
        assert!((actual - expected).abs() < 1e-12);
    }
    let starts = std::iter::once(0).chain(stops);
    let mut cases: Vec<_> = starts.zip(stops).zip(&actual.without).collect();
    cases.push(((0, 0), &actual.total));
    for ((start, stop), actual) in cases {
        let others = example.without(start, stop);
        let residuals = eliminate::<false>(others.windows(), &others.y, SIDES)
            .unwrap()
            .residuals;
        for (place, actual) in actual.iter().enumerate() {
            let (i, j) = (place / SIDES, place % SIDES);
            let rows = others
                .y
                .chunks_exact(SIDES)
                .zip(residuals.chunks_exact(SIDES));
            let expected: f64 = rows.map(|(y, residual)| y[i] * residual[j]).sum();
            assert!((actual - expected).abs() < 1e-9, "{actual} {expected}");
        }
    }
}

#[test]
fn plain_and_fused_agree() {
    let example = Example::new();
    let (z, y) = (example.windows(), &example.y);
    let (plain, best) = (
        eliminate::<false>(z, y, SIDES),
        eliminate::<true>(z, y, SIDES),
    );
    for (a, b) in plain.unwrap().residuals.iter().zip(best.unwrap().residuals) {
        assert!((a - b).abs() < 1e-10);
    }
}

#[test]
fn rejects_non_finite_entries() {
    let z = Windows {
        first: &[0],
        entries: &[1.0, f64::NAN],
        width: 2,
        unknowns: 2,
    };
    assert_eq!(eliminate::<false>(z, &[1.0], 1), None);
}

#[test]
fn windows_must_end_at_the_last_unknown() {
    let windows = |entries, unknowns| Windows {
        first: &[1],
        entries,
        width: 2,
        unknowns,
    };
    assert!(windows(&[1.0, 1.0], 3).fit());
    assert!(windows(&[1.0, 0.0], 2).fit());
    assert!(!windows(&[1.0, 1.0], 2).fit());
    assert!(!windows(&[1.0], 3).fit());
}
