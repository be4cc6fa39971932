//! Update of a triangular factor by a row with few entries.

/// Rotates a row into an upper triangle of `n` columns, row by row.
///
/// Entry k of the row belongs to column `at(k)`, which increases with k. The row is used up.
pub fn append(factor: &mut [f64], n: usize, row: &mut [f64], at: impl Fn(usize) -> usize) {
    for k in 0..row.len() {
        let (x, diagonal) = (row[k], at(k) * n + at(k));
        if x == 0.0 {
            continue;
        }
        let radius = f64::hypot(factor[diagonal], x);
        let (cosine, sine) = (factor[diagonal] / radius, x / radius);
        for l in k..row.len() {
            let (above, own) = (factor[at(k) * n + at(l)], row[l]);
            factor[at(k) * n + at(l)] = cosine * above + sine * own;
            row[l] = cosine * own - sine * above;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// R'R of the factor is the sum of the products of the rows.
        #[test]
        fn factor_has_the_products_of_its_rows(
            rows in prop::collection::vec(prop::collection::vec(-1.0..1.0, 3), 1..9),
        ) {
            const N: usize = 5;
            let mut factor = [0.0; N * N];
            let mut products = [0.0; N * N];
            for (i, row) in rows.iter().enumerate() {
                let columns = if i % 2 == 0 { [0, 2, 4] } else { [1, 2, 4] };
                for (k, x) in columns.iter().zip(row) {
                    for (l, y) in columns.iter().zip(row) {
                        products[k * N + l] += x * y;
                    }
                }
                append(&mut factor, N, &mut row.clone(), |k| columns[k]);
            }
            for k in 0..N {
                for l in 0..N {
                    let product: f64 = (0..N).map(|i| factor[i * N + k] * factor[i * N + l]).sum();
                    prop_assert!((product - products[k * N + l]).abs() < 1e-12);
                    prop_assert!(l >= k || factor[k * N + l] == 0.0);
                }
            }
        }
    }
}
