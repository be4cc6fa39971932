//! Products Z'Z of block-Hankel matrices, computed without forming the matrix.

use crate::model::{Record, Shape};
use strainwave_numerics::products::{Part, Rows, add_products};

/// Z'Z, where row k of Z is [z[k], z[k+1], ..., z[k+depth-1]] with samples z = [u, y].
///
/// Only the first block row is summed over the data. Successive blocks of a block diagonal differ
/// by one sample that enters and one that leaves: G[i+1, j+1] = G[i, j] + z[N+i] z[N+j]' - z[i]
/// z[j]' (N rows of Z). This takes n_samples width^2 depth products, a factor of depth fewer.
///
/// Records contribute n_samples - depth + 1 rows each; shorter records contribute none. `order` is
/// the permutation of the columns of Z. Returns the row-major matrix and the number of rows of Z.
///
/// # Panics
/// `order` does not have a column per channel and sample of a row.
pub fn gram(
    shape: Shape,
    records: &[Record<'_>],
    depth: usize,
    order: &[usize],
) -> (Vec<f64>, usize) {
    let width = shape.inputs + shape.outputs;
    let size = depth * width;
    assert_eq!(order.len(), size, "columns of the Hankel matrix");
    let mut total = vec![0.0; size * size];
    let mut rows = 0;
    for record in records.iter().filter(|record| record.len >= depth) {
        rows += record.len - depth + 1;
        let mut z = Vec::with_capacity(record.len * width);
        let inputs = record.inputs.chunks_exact(shape.inputs);
        for (u, y) in inputs.zip(record.outputs.chunks_exact(shape.outputs)) {
            z.extend_from_slice(u);
            z.extend_from_slice(y);
        }
        add_record(&mut total, &z, width, record.len - depth + 1, depth);
    }
    let mut ordered = vec![0.0; size * size];
    for (row, &i) in ordered.chunks_exact_mut(size).zip(order) {
        for (entry, &j) in row.iter_mut().zip(order) {
            *entry = total[i.min(j) * size + i.max(j)];
        }
    }
    (ordered, rows)
}

/// Adds the upper block triangle of one record's Z'Z.
fn add_record(total: &mut [f64], record: &[f64], width: usize, rows: usize, depth: usize) {
    let size = depth * width;
    let mut first = vec![0.0; width * size];
    let left = Rows {
        data: record,
        stride: width,
        width,
    };
    let right = Rows {
        data: record,
        stride: width,
        width: size,
    };
    add_products(&mut first, left, right, rows, Part::Whole);
    // `first` becomes block row i: shifted right by one block, with one sample updated.
    for i in 0..depth {
        for a in 0..width {
            let columns = size - i * width;
            let target = &mut total[(i * width + a) * size + i * width..][..columns];
            let source = &mut first[a * size..][..columns];
            target
                .iter_mut()
                .zip(source.iter())
                .for_each(|(t, s)| *t += s);
            if i + 1 < depth {
                let (leaves, affects) = (record[i * width + a], record[(rows + i) * width + a]);
                let tail = columns - width;
                let leaving = &record[i * width..][..tail];
                let entering = &record[(rows + i) * width..][..tail];
                for j in 0..tail {
                    source[j] += affects * entering[j] - leaves * leaving[j];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::split;

    #[test]
    fn equals_matrix_product() {
        let width = 3;
        let data: Vec<f64> = (0..40 * width)
            .map(|i| f64::from(i as u32 * 31 % 17) - 8.0)
            .collect();
        let lengths = [25, 3, 12];
        let depth = 5;
        let size = depth * width;
        let order: Vec<usize> = (0..size).map(|i| i * 7 % size).collect();
        let column = |channels: std::ops::Range<usize>| -> Vec<f64> {
            let samples = data.chunks_exact(width);
            samples.flat_map(|z| z[channels.clone()].to_vec()).collect()
        };
        let (inputs, outputs) = (column(0..1), column(1..width));
        let shape = Shape {
            order: 1,
            inputs: 1,
            outputs: width - 1,
        };
        let records = split(shape, &inputs, &outputs, &lengths);
        let (gram, rows) = gram(shape, &records, depth, &order);
        assert_eq!(rows, 21 + 8);
        let starts: Vec<usize> = (0..21).chain(28..36).collect();
        for i in 0..size {
            for j in 0..size {
                let plain: f64 = starts
                    .iter()
                    .map(|k| data[k * width + order[i]] * data[k * width + order[j]])
                    .sum();
                assert_eq!(gram[i * size + j], plain);
            }
        }
    }
}
