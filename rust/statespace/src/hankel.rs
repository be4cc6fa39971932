//! Products Z'Z of block-Hankel matrices, computed without forming the matrix.

use strainwave_numerics::products::{Part, Rows, add_products};

/// Z'Z, where row k of Z is [z[k], z[k+1], ..., z[k+depth-1]], for rows z of `width` numbers.
///
/// Only the first block row is summed over the data. Successive blocks of a block diagonal differ
/// by one sample that enters and one that leaves: G[i+1, j+1] = G[i, j] + z[N+i] z[N+j]' - z[i]
/// z[j]' (N rows of Z). This takes n_samples width^2 depth products, a factor of depth fewer.
///
/// Records are stacked and contribute n_samples - depth + 1 rows each; shorter records contribute
/// none. Returns the (depth width, depth width) row-major matrix and the number of rows of Z.
///
/// # Panics
/// The lengths do not add up to the rows of `data`.
pub fn gram(data: &[f64], width: usize, lengths: &[usize], depth: usize) -> (Vec<f64>, usize) {
    let size = depth * width;
    assert_eq!(
        data.len(),
        lengths.iter().sum::<usize>() * width,
        "rows of data"
    );
    let mut total = vec![0.0; size * size];
    let mut rows = 0;
    let mut start = 0;
    for &len in lengths {
        let record = &data[start * width..(start + len) * width];
        start += len;
        if len >= depth {
            rows += len - depth + 1;
            add_record(&mut total, record, width, len - depth + 1, depth);
        }
    }
    for i in 0..size {
        for j in 0..i {
            total[i * size + j] = total[j * size + i];
        }
    }
    (total, rows)
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

    #[test]
    fn equals_matrix_product() {
        let width = 3;
        let data: Vec<f64> = (0..40 * width)
            .map(|i| f64::from(i as u32 * 31 % 17) - 8.0)
            .collect();
        let lengths = [25, 3, 12];
        let depth = 5;
        let size = depth * width;
        let (gram, rows) = gram(&data, width, &lengths, depth);
        assert_eq!(rows, 21 + 8);
        let starts: Vec<usize> = (0..21).chain(28..36).collect();
        for i in 0..size {
            for j in 0..size {
                let plain: f64 = starts
                    .iter()
                    .map(|k| data[k * width + i] * data[k * width + j])
                    .sum();
                assert_eq!(gram[i * size + j], plain);
            }
        }
    }
}
