//! Sums of outer products over many rows, the most expensive operation of the state-space fits.

/// Rows of a tile of the sum that is kept in registers.
const TILE_ROWS: usize = 4;
/// Columns of a tile, and those with AVX-512.
const TILE_COLUMNS: [usize; 2] = [12, 24];

/// Rows summed per tile before the next tile, so that they stay in the first-level cache.
const BLOCK: usize = 256;

/// Rows of `width` numbers; each row starts `stride` numbers after the previous one.
///
/// A stride below the width makes a block-Hankel matrix without copying the data.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    /// Numbers, row by row.
    pub data: &'a [f64],
    /// Distance between the first entries of successive rows.
    pub stride: usize,
    /// Entries of a row.
    pub width: usize,
}

/// Part of a product to be computed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The whole product.
    Whole,
    /// Tiles with an entry on or above the diagonal.
    Upper,
}

/// Adds left' right, summed over `count` rows, to a (left.width, right.width) row-major matrix.
///
/// Uses vectors and fused multiply-add if the processor has them, decided at run time on x86-64.
pub fn add_products(target: &mut [f64], left: Rows<'_>, right: Rows<'_>, count: usize, part: Part) {
    assert_eq!(target.len(), left.width * right.width);
    if count == 0 {
        return;
    }
    for rows in [left, right] {
        assert!((count - 1) * rows.stride + rows.width <= rows.data.len());
    }
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        if is_x86_feature_detected!("avx512f") && right.width >= TILE_COLUMNS[1] {
            // SAFETY: all features have just been detected.
            return unsafe { add_products_avx512(target, left, right, count, part) };
        }
        // SAFETY: both features have just been detected.
        return unsafe { add_products_avx2(target, left, right, count, part) };
    }
    blocks::<BASELINE_IS_FUSED, { TILE_COLUMNS[0] }>(target, left, right, count, part);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f")]
fn add_products_avx512(
    target: &mut [f64],
    left: Rows<'_>,
    right: Rows<'_>,
    count: usize,
    part: Part,
) {
    blocks::<true, { TILE_COLUMNS[1] }>(target, left, right, count, part);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn add_products_avx2(
    target: &mut [f64],
    left: Rows<'_>,
    right: Rows<'_>,
    count: usize,
    part: Part,
) {
    blocks::<true, { TILE_COLUMNS[0] }>(target, left, right, count, part);
}

#[inline(always)]
fn blocks<const FUSED: bool, const COLUMNS: usize>(
    target: &mut [f64],
    left: Rows<'_>,
    right: Rows<'_>,
    count: usize,
    part: Part,
) {
    for start in (0..count).step_by(BLOCK) {
        let rows = BLOCK.min(count - start);
        let from = |rows: Rows<'_>| -> usize { start * rows.stride };
        let (l, r) = (&left.data[from(left)..], &right.data[from(right)..]);
        for i in (0..left.width).step_by(TILE_ROWS) {
            for j in (0..right.width).step_by(COLUMNS) {
                if part == Part::Upper && j + COLUMNS <= i {
                    continue;
                }
                if i + TILE_ROWS <= left.width && j + COLUMNS <= right.width {
                    let tile = &mut target[i * right.width + j..];
                    let (l, r) = ((&l[i..], left.stride), (&r[j..], right.stride));
                    whole_tile::<FUSED, COLUMNS>(tile, right.width, l, r, rows);
                } else if left.width >= TILE_ROWS && right.width >= COLUMNS {
                    // The last tiles begin earlier and repeat some sums, which are not added.
                    let top = i.min(left.width - TILE_ROWS);
                    let first = j.min(right.width - COLUMNS);
                    let (l, r) = ((&l[top..], left.stride), (&r[first..], right.stride));
                    let mut sums = [[0.0; COLUMNS]; TILE_ROWS];
                    let tile = sums.as_flattened_mut();
                    whole_tile::<FUSED, COLUMNS>(tile, COLUMNS, l, r, rows);
                    for a in i..top + TILE_ROWS {
                        for b in j..first + COLUMNS {
                            target[a * right.width + b] += sums[a - top][b - first];
                        }
                    }
                } else {
                    let tile = &mut target[i * right.width + j..];
                    let height = TILE_ROWS.min(left.width - i);
                    let width = COLUMNS.min(right.width - j);
                    for row in 0..rows {
                        for a in 0..height {
                            let weight = l[row * left.stride + i + a];
                            let source = &r[row * right.stride + j..][..width];
                            let sum = &mut tile[a * right.width..][..width];
                            for b in 0..width {
                                sum[b] = multiply_add::<FUSED>(weight, source[b], sum[b]);
                            }
                        }
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn whole_tile<const FUSED: bool, const COLUMNS: usize>(
    target: &mut [f64],
    target_stride: usize,
    (left, left_stride): (&[f64], usize),
    (right, right_stride): (&[f64], usize),
    rows: usize,
) {
    let mut sums = [[0.0; COLUMNS]; TILE_ROWS];
    for row in 0..rows {
        let l: &[f64; TILE_ROWS] = left[row * left_stride..][..TILE_ROWS].try_into().unwrap();
        let r: &[f64; COLUMNS] = right[row * right_stride..][..COLUMNS].try_into().unwrap();
        for a in 0..TILE_ROWS {
            for b in 0..COLUMNS {
                sums[a][b] = multiply_add::<FUSED>(l[a], r[b], sums[a][b]);
            }
        }
    }
    for (a, row) in sums.iter().enumerate() {
        let target = &mut target[a * target_stride..][..COLUMNS];
        target.iter_mut().zip(row).for_each(|(t, s)| *t += s);
    }
}

/// Whether the baseline of the target has fused multiply-add.
pub const BASELINE_IS_FUSED: bool = cfg!(target_arch = "aarch64");

/// a b + c, rounded once if the processor has an instruction for it.
#[inline(always)]
pub fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Calls a function with the widest vectors of the processor, decided at run time on x86-64.
///
/// The function is always inlined; its first generic argument states whether `multiply_add` is one
/// instruction.
macro_rules! with_vectors {
    ($function:ident($($argument:ident: $type:ty),*) -> $result:ty) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma,avx512f")]
        fn avx512($($argument: $type),*) -> $result {
            $function::<true>($($argument),*)
        }

        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        fn avx2($($argument: $type),*) -> $result {
            $function::<true>($($argument),*)
        }

        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: all features have just been detected.
                return unsafe { avx512($($argument),*) };
            }
            // SAFETY: both features have just been detected.
            return unsafe { avx2($($argument),*) };
        }
        $function::<{ $crate::products::BASELINE_IS_FUSED }>($($argument),*)
    }};
}
pub(crate) use with_vectors;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_plain_sum() {
        let data: Vec<f64> = (0..4000).map(|i| f64::from(i * 37 % 101) - 50.0).collect();
        for (h, w, stride, count) in [
            (4, 8, 8, 300),
            (5, 11, 3, 259),
            (6, 20, 4, 130),
            (1, 1, 1, 1),
            (9, 24, 24, 64),
            (6, 31, 4, 300),
        ] {
            let left = Rows {
                data: &data,
                stride,
                width: h,
            };
            let right = Rows {
                data: &data[7..],
                stride,
                width: w,
            };
            let mut sum = vec![1.0; h * w];
            add_products(&mut sum, left, right, count, Part::Whole);
            for i in 0..h {
                for j in 0..w {
                    let plain: f64 = (0..count)
                        .map(|row| data[row * stride + i] * data[7 + row * stride + j])
                        .sum();
                    assert_eq!(sum[i * w + j], 1.0 + plain);
                }
            }
        }
    }
}
