//! Control loops of a plant with several inputs and outputs, each with the other loops closed.

use std::sync::atomic::{Ordering, compiler_fence};

use crate::products::{multiply_add, with_vectors};

/// Frequencies side by side.
const LANES: usize = 8;

/// Complex numbers at neighbouring frequencies.
#[derive(Clone, Copy)]
struct Lanes {
    re: [f64; LANES],
    im: [f64; LANES],
}

/// Loops of all joints (n, n_plants, n_omega), each with the loops of the other joints closed.
///
/// `responses` (n_plants, n_pairs, n_omega) are the symmetric S of pairs of joints (0, 0), (0, 1)
/// ... (n - 1, n - 1), `roots` (n, n_omega) the roots g of the factors by which S g^2 are the
/// responses of all open loops. Complex numbers are pairs of real and imaginary part. The loop of
/// joint i is
///
/// L_i = 1 / [(1 + g S g)^-1]_ii - 1
///
/// and the inverse is that of Dempster's sweep without the entries that are not used.
pub fn open_loops(responses: &[f64], roots: &[f64], n: usize) -> Vec<f64> {
    let width = roots.len() / n;
    assert!(responses.len().is_multiple_of(n * (n + 1) / 2 * width));
    with_vectors!(each_plant(responses: &[f64], roots: &[f64], n: usize) -> Vec<f64>)
}

#[inline(always)]
fn each_plant<const FUSED: bool>(responses: &[f64], roots: &[f64], n: usize) -> Vec<f64> {
    let (width, n_pairs) = (roots.len() / n, n * (n + 1) / 2);
    let n_plants = responses.len() / (n_pairs * width);
    let mut loops = vec![0.0; n * n_plants * width];
    let mut a = vec![ZERO; n * n];
    let mut column = vec![ZERO; n];
    for first in (0..width).step_by(2 * LANES) {
        let places = first..(first + 2 * LANES).min(width);
        let roots: Vec<Lanes> = roots
            .chunks(width)
            .map(|row| load(&row[places.clone()]))
            .collect();
        for (plant, pairs) in responses.chunks(n_pairs * width).enumerate() {
            let mut pairs = pairs.chunks(width);
            for i in 0..n {
                for j in i..n {
                    let pair = pairs.next().expect("a response of each pair");
                    let root = product::<FUSED>(roots[i], roots[j]);
                    a[i * n + j] = product::<FUSED>(load(&pair[places.clone()]), root);
                }
                for lane in 0..LANES {
                    a[i * n + i].re[lane] += 1.0;
                }
            }
            sweep::<FUSED>(&mut a, &mut column, n);
            for i in 0..n {
                let mut opened = inverse(a[i * n + i]);
                for lane in 0..LANES {
                    opened.re[lane] = -1.0 - opened.re[lane];
                    opened.im[lane] = -opened.im[lane];
                }
                let row = &mut loops[(i * n_plants + plant) * width..][..width];
                store(opened, &mut row[places.clone()]);
            }
        }
    }
    loops
}

/// Replaces the diagonal of a symmetric matrix, stored above it, by minus that of its inverse.
#[inline(always)]
fn sweep<const FUSED: bool>(a: &mut [Lanes], column: &mut [Lanes], n: usize) {
    for k in 0..n {
        let pivot = inverse(a[k * n + k]);
        for i in 0..n {
            column[i] = a[i.min(k) * n + i.max(k)];
        }
        for i in (0..n).filter(|&i| i != k) {
            let row = product::<FUSED>(column[i], pivot);
            subtract_product::<FUSED>(&mut a[i * n + i], row, column[i]);
            // off the diagonal, entries of two joints before k are not used any more
            for j in i.max(k) + 1..n {
                subtract_product::<FUSED>(&mut a[i * n + j], row, column[j]);
            }
            a[i.min(k) * n + i.max(k)] = row;
        }
        let diagonal = &mut a[k * n + k];
        for lane in 0..LANES {
            diagonal.re[lane] = -pivot.re[lane];
            diagonal.im[lane] = -pivot.im[lane];
        }
    }
}

const ZERO: Lanes = Lanes {
    re: [0.0; LANES],
    im: [0.0; LANES],
};

/// Numbers from pairs of real and imaginary part; zero after the last one.
#[inline(always)]
fn load(pairs: &[f64]) -> Lanes {
    let mut numbers = ZERO;
    for (lane, pair) in pairs.chunks_exact(2).enumerate() {
        numbers.re[lane] = pair[0];
        numbers.im[lane] = pair[1];
    }
    numbers
}

#[inline(always)]
fn store(numbers: Lanes, pairs: &mut [f64]) {
    for (lane, pair) in pairs.chunks_exact_mut(2).enumerate() {
        pair[0] = numbers.re[lane];
        pair[1] = numbers.im[lane];
    }
}

#[inline(always)]
fn inverse(a: Lanes) -> Lanes {
    let mut result = ZERO;
    for lane in 0..LANES {
        let scale = 1.0 / (a.re[lane] * a.re[lane] + a.im[lane] * a.im[lane]);
        result.re[lane] = a.re[lane] * scale;
        result.im[lane] = -a.im[lane] * scale;
    }
    result
}

#[inline(always)]
fn product<const FUSED: bool>(a: Lanes, b: Lanes) -> Lanes {
    let mut result = ZERO;
    for lane in 0..LANES {
        result.re[lane] = multiply_add::<FUSED>(a.re[lane], b.re[lane], -(a.im[lane] * b.im[lane]));
    }
    for lane in 0..LANES {
        result.im[lane] = multiply_add::<FUSED>(a.re[lane], b.im[lane], a.im[lane] * b.re[lane]);
    }
    result
}

/// Subtracts b c from a.
///
/// The fences, which are no instructions, keep the compiler from mixing real and imaginary parts in
/// a register.
#[inline(always)]
fn subtract_product<const FUSED: bool>(a: &mut Lanes, b: Lanes, c: Lanes) {
    for lane in 0..LANES {
        let rest = multiply_add::<FUSED>(b.im[lane], c.im[lane], a.re[lane]);
        a.re[lane] = multiply_add::<FUSED>(-b.re[lane], c.re[lane], rest);
    }
    compiler_fence(Ordering::SeqCst);
    for lane in 0..LANES {
        let rest = multiply_add::<FUSED>(-b.im[lane], c.re[lane], a.im[lane]);
        a.im[lane] = multiply_add::<FUSED>(-b.re[lane], c.im[lane], rest);
    }
    compiler_fence(Ordering::SeqCst);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A product of complex numbers.
    fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
    }

    proptest! {
        /// For two joints, L_1 = f_1 (S_11 - f_2 S_12^2 / (1 + f_2 S_22)), and the reverse.
        #[test]
        fn the_other_loop_of_two_is_closed(
            n_omega in 1usize..20,
            n_plants in 1usize..4,
            draws in prop::collection::vec(-1.0..1.0f64, 400),
        ) {
            let numbers: Vec<[f64; 2]> = draws.chunks(2).map(|pair| [pair[0], pair[1]]).collect();
            let roots = &numbers[..2 * n_omega];
            let responses = numbers.iter().cycle().skip(7).take(n_plants * 3 * n_omega);
            let responses: Vec<[f64; 2]> = responses.copied().collect();
            let loops = open_loops(responses.as_flattened(), roots.as_flattened(), 2);
            for (plant, pairs) in responses.chunks(3 * n_omega).enumerate() {
                for k in 0..n_omega {
                    let f = [0, 1].map(|i| times(roots[i * n_omega + k], roots[i * n_omega + k]));
                    let cross = times(pairs[n_omega + k], pairs[n_omega + k]);
                    for i in 0..2 {
                        let [own, other] = [i, 1 - i].map(|i| pairs[2 * i * n_omega + k]);
                        let closed = times(f[1 - i], other);
                        let closed = [1.0 + closed[0], closed[1]];
                        let square = closed[0] * closed[0] + closed[1] * closed[1];
                        prop_assume!(square > 1e-3);
                        let through = times(times(f[1 - i], cross), [closed[0], -closed[1]]);
                        let rest = [0, 1].map(|part| own[part] - through[part] / square);
                        let expected = times(f[i], rest);
                        let at = 2 * ((i * n_plants + plant) * n_omega + k);
                        let size = 1.0 + expected[0].hypot(expected[1]);
                        for part in 0..2 {
                            let error = (loops[at + part] - expected[part]).abs();
                            prop_assert!(error < 1e-9 * size * size);
                        }
                    }
                }
            }
        }
    }
}
