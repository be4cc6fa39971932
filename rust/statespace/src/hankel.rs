//! Triangular factors of block-Hankel matrices, computed without forming the matrix.

use crate::model::{Record, Shape};
use strainwave_numerics::cholesky::upper_factor;
use strainwave_numerics::products::{Part, Rows, add_products};
use strainwave_numerics::triangular::TriangularFactor;

/// Smallest ratio of pivots for which the Gram matrix is used instead of a QR decomposition. The
/// relative error of the weakest direction is then about 1e-16 / 1e-12, below the noise of measured
/// data.
pub const MIN_PIVOT_RATIO: f64 = 1e-6;

/// Correlations of stacked records, from which the Gram matrices of their Hankel matrices follow.
///
/// Row k of a Hankel matrix Z is [z[k], z[k+1], ..., z[k+depth-1]] with samples z = [u, y]. Records
/// contribute n_samples - depth + 1 rows each; shorter records contribute none.
pub struct Hankel<'a> {
    width: usize,
    depth: usize,
    /// Samples (n_samples, width) and first block row (width, depth width) of Z'Z, by record.
    records: Vec<(&'a [f64], Vec<f64>)>,
}

impl<'a> Hankel<'a> {
    /// Correlations for Hankel matrices with at most `depth` samples in a row.
    pub fn new(shape: Shape, records: &[Record<'a>], depth: usize) -> Self {
        let width = shape.inputs + shape.outputs;
        let records = records.iter().map(|record| {
            let mut first = vec![0.0; width * depth * width];
            let rows = (record.len + 1).saturating_sub(depth);
            add_correlations(&mut first, record.samples, width, rows);
            (record.samples, first)
        });
        Self {
            width,
            depth,
            records: records.collect(),
        }
    }

    /// R with R'R = Z'Z for the Hankel matrix with `depth` samples in a row, and the number of rows
    /// of Z.
    ///
    /// `order` is the permutation of the columns of Z. R is the Cholesky factor of Z'Z, or the
    /// triangular factor of Z if Z'Z is ill-conditioned. Only the first `pivots` rows of R are
    /// computed by the former; the others are not to be used.
    ///
    /// # Panics
    /// The depth exceeds that of the correlations, or `order` does not have a column per channel and
    /// sample of a row.
    pub fn factor(&self, depth: usize, order: &[usize], pivots: usize) -> (Vec<f64>, usize) {
        let size = depth * self.width;
        assert!(depth <= self.depth, "depth of the correlations");
        assert_eq!(order.len(), size, "columns of the Hankel matrix");
        let (mut factor, rows) = self.gram(depth, order);
        if !upper_factor(&mut factor, size, pivots) || !is_well_conditioned(&factor, size, pivots) {
            factor = self.orthogonal_factor(depth, order);
        }
        (factor, rows)
    }

    /// Upper half of Z'Z, and the number of rows of Z.
    ///
    /// Only the first block row is summed over the data. Successive blocks of a block diagonal differ
    /// by one sample that enters and one that leaves: G[i+1, j+1] = G[i, j] + z[N+i] z[N+j]' - z[i]
    /// z[j]' (N rows of Z). This takes n_samples width^2 depth products, a factor of depth fewer.
    fn gram(&self, depth: usize, order: &[usize]) -> (Vec<f64>, usize) {
        let (width, size) = (self.width, depth * self.width);
        let mut total = vec![0.0; size * size];
        let mut count = 0;
        for (z, first) in &self.records {
            let samples = z.len() / width;
            if samples < depth {
                continue;
            }
            let rows = samples - depth + 1;
            count += rows;
            let mut block_row = Vec::with_capacity(width * size);
            for row in first.chunks_exact(self.depth * width) {
                block_row.extend_from_slice(&row[..size]);
            }
            // a shorter row leaves room for more rows
            let summed = (samples + 1).saturating_sub(self.depth);
            add_correlations(&mut block_row, &z[summed * width..], width, rows - summed);
            add_blocks(&mut total, &mut block_row, z, width, rows);
        }
        let mut ordered = vec![0.0; size * size];
        for (i, row) in ordered.chunks_exact_mut(size).enumerate() {
            for (entry, &j) in row[i..].iter_mut().zip(&order[i..]) {
                *entry = total[order[i].min(j) * size + order[i].max(j)];
            }
        }
        (ordered, count)
    }

    /// Triangular factor by reflections of the rows of Z.
    fn orthogonal_factor(&self, depth: usize, order: &[usize]) -> Vec<f64> {
        let size = depth * self.width;
        let mut factor = TriangularFactor::new(size);
        let mut ordered = vec![0.0; size];
        for (z, _) in &self.records {
            for row in z.windows(size).step_by(self.width) {
                for (entry, &column) in ordered.iter_mut().zip(order) {
                    *entry = row[column];
                }
                factor.add(&ordered);
            }
        }
        factor.finish()
    }
}

/// Whether the smallest of the first pivots of R exceeds a fraction of the largest.
pub fn is_well_conditioned(factor: &[f64], size: usize, pivots: usize) -> bool {
    let (mut least, mut largest) = (f64::INFINITY, 0.0_f64);
    for i in 0..pivots {
        let pivot = factor[i * size + i].abs();
        (least, largest) = (least.min(pivot), largest.max(pivot));
    }
    least >= MIN_PIVOT_RATIO * largest && largest > 0.0
}

/// Adds the products of a sample with those that follow it, over `rows` samples.
fn add_correlations(first: &mut [f64], z: &[f64], width: usize, rows: usize) {
    let part = |columns| Rows {
        data: z,
        stride: width,
        width: columns,
    };
    let columns = first.len() / width;
    add_products(first, part(width), part(columns), rows, Part::Whole);
}

/// Adds the upper block triangle of one record's Z'Z, for its first block row.
fn add_blocks(total: &mut [f64], block_row: &mut [f64], z: &[f64], width: usize, rows: usize) {
    let size = block_row.len() / width;
    // `block_row` becomes block row i: shifted right by one block, with one sample updated
    for i in 0..size / width {
        let columns = size - i * width;
        for a in 0..width {
            let target = &mut total[(i * width + a) * size + i * width..][..columns];
            let source = &mut block_row[a * size..][..columns];
            target
                .iter_mut()
                .zip(source.iter())
                .for_each(|(t, s)| *t += s);
            let tail = columns - width;
            if tail > 0 {
                let (leaves, enters) = (z[i * width + a], z[(rows + i) * width + a]);
                let leaving = &z[i * width..][..tail];
                let entering = &z[(rows + i) * width..][..tail];
                for j in 0..tail {
                    source[j] += enters * entering[j] - leaves * leaving[j];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;

    const WIDTH: usize = 3;
    const LENGTHS: [usize; 4] = [25, 3, 12, 7];
    const SHAPE: Shape = Shape {
        order: 1,
        inputs: 1,
        outputs: WIDTH - 1,
    };

    fn data() -> Vec<f64> {
        let samples: usize = LENGTHS.iter().sum();
        (0..samples * WIDTH)
            .map(|i| f64::from(i as u32 * i as u32 % 17) - 8.0)
            .collect()
    }

    fn correlations(data: &[f64], depth: usize) -> Hankel<'_> {
        Hankel::new(SHAPE, &split(SHAPE, data, &LENGTHS), depth)
    }

    /// Z'Z by definition, of permuted columns.
    fn product(data: &[f64], depth: usize, i: usize, j: usize) -> f64 {
        let mut sum = 0.0;
        let mut start = 0;
        for length in LENGTHS {
            for k in start..(start + length + 1).saturating_sub(depth).max(start) {
                sum += data[k * WIDTH + i] * data[k * WIDTH + j];
            }
            start += length;
        }
        sum
    }

    /// Correlations of depth 9 give the products of shorter rows as well.
    #[test]
    fn gram_equals_matrix_product() {
        let data = data();
        let hankel = correlations(&data, 9);
        for (depth, expected_rows) in [(9, 17 + 4), (5, 21 + 8 + 3), (1, 47)] {
            let size = depth * WIDTH;
            let order: Vec<usize> = (0..size).map(|i| i * 7 % size).collect();
            let order = if size.is_multiple_of(7) {
                (0..size).collect()
            } else {
                order
            };
            let (gram, rows) = hankel.gram(depth, &order);
            assert_eq!(rows, expected_rows);
            for i in 0..size {
                for j in i..size {
                    assert_eq!(
                        gram[i * size + j],
                        product(&data, depth, order[i], order[j])
                    );
                }
            }
        }
    }

    /// Cholesky and QR decompositions give factors of the same product; the latter is used for
    /// columns that depend on others.
    #[test]
    fn factors_have_the_products_of_the_matrix() {
        let mut data = data();
        for depends in [false, true] {
            if depends {
                for z in data.chunks_exact_mut(WIDTH) {
                    z[2] = 2.0 * z[1];
                }
            }
            let (depth, size) = (3, 3 * WIDTH);
            let order: Vec<usize> = (0..size).rev().collect();
            let (factor, _) = correlations(&data, depth).factor(depth, &order, size);
            for i in 0..size {
                for j in 0..size {
                    let sum: f64 = (0..size)
                        .map(|k| factor[k * size + i] * factor[k * size + j])
                        .sum();
                    let expected = product(&data, depth, order[i], order[j]);
                    // rounding of sums of about 2000
                    assert!(
                        (sum - expected).abs() < 1e-10,
                        "{depends}: {sum} {expected}"
                    );
                }
            }
        }
    }
}
