//! A filter with a symmetric impulse response, at selected samples.
//!
//! For samples that are far apart, the sums cost less than transforms of the whole signal.

use crate::products::{BASELINE_IS_FUSED, multiply_add};

/// Samples at which a filter is evaluated.
#[derive(Clone, Copy, Debug)]
pub struct Samples {
    /// The first one.
    pub first: usize,
    /// Distance between successive ones.
    pub step: usize,
    /// Their number.
    pub count: usize,
}

impl Samples {
    /// Whether all of them are among `length` samples.
    pub fn fit(self, length: usize) -> bool {
        self.count == 0 || self.first + (self.count - 1) * self.step < length
    }
}

/// Numbers of a vector of sums.
const WIDTH: usize = 16;
/// Vectors of sums that are kept in registers (`SUMS` below), and those with AVX-512.
const TILE_SUMS: [usize; 2] = [2, 4];

/// Filtered samples, (count, columns), of a signal (n, columns).
///
/// `response` is the impulse response at the impulse and at later samples; it is the same at
/// earlier ones. The signal is extended by point reflection at both ends. Panics if samples are
/// beyond the signal, or if the response is longer.
pub fn filter(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    let length = signal.len() / columns;
    assert!(samples.fit(length) && response.len() <= length && samples.step > 0);
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: all features have just been detected.
            return unsafe { filter_avx512(signal, columns, response, samples) };
        }
        // SAFETY: both features have just been detected.
        return unsafe { filter_avx2(signal, columns, response, samples) };
    }
    filter_with::<BASELINE_IS_FUSED, { TILE_SUMS[0] }>(signal, columns, response, samples)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f")]
fn filter_avx512(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    filter_with::<true, { TILE_SUMS[1] }>(signal, columns, response, samples)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn filter_avx2(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    filter_with::<true, { TILE_SUMS[0] }>(signal, columns, response, samples)
}

#[inline(always)]
fn filter_with<const FUSED: bool, const SUMS: usize>(
    signal: &[f64],
    columns: usize,
    response: &[f64],
    samples: Samples,
) -> Vec<f64> {
    let Samples { first, step, count } = samples;
    let (length, reach) = (signal.len() / columns, response.len() - 1);
    // successive samples fill a vector
    let run = match step {
        1 if WIDTH.is_multiple_of(columns) => WIDTH / columns,
        _ => 1,
    };
    let pass = Pass::<SUMS>::new(response, columns, run, step * run);
    let spare = WIDTH.div_ceil(columns); // samples beyond the window of a sum that a vector contains
    let until = |sample: usize| sample.saturating_sub(first).div_ceil(step).min(count);
    let head = until(reach);
    let tail = until(length.saturating_sub(reach + spare)).max(head);
    let mut result = vec![0.0; count * columns];
    for (from, to) in [(0, head), (head, tail), (tail, count)] {
        let target = &mut result[from * columns..to * columns];
        let begin = first + from * step;
        if from == to {
            continue;
        }
        let mut piece = Vec::new();
        if from != head || to != tail {
            let window = 2 * reach + 1 + (to - from - 1) * step;
            piece.reserve_exact((window + spare) * columns);
            for at in begin..begin + window {
                extend(&mut piece, signal, columns, at, reach);
            }
            piece.resize((window + spare) * columns, 0.0);
        }
        let inside = if piece.is_empty() {
            &signal[(begin - reach) * columns..]
        } else {
            &piece
        };
        pass.apply::<FUSED>(inside, target);
    }
    result
}

/// Appends sample `at - reach` of a signal that is extended by point reflection at both ends.
#[inline(always)]
fn extend(piece: &mut Vec<f64>, signal: &[f64], columns: usize, at: usize, reach: usize) {
    let last = signal.len() / columns - 1;
    let row = |k: usize| &signal[k * columns..][..columns];
    let (end, mirrored) = if at < reach {
        (row(0), row(reach - at))
    } else if at - reach > last {
        (row(last), row(2 * last - (at - reach)))
    } else {
        piece.extend_from_slice(row(at - reach));
        return;
    };
    for j in 0..columns {
        piece.push(2.0 * end[j] - mirrored[j]);
    }
}

/// Sums over a response for vectors of numbers at equal distances.
struct Pass<const SUMS: usize> {
    /// The response on both sides of the impulse; zeros let the windows of a tile differ.
    response: Vec<f64>,
    taps: usize,
    columns: usize,
    /// Samples of a vector.
    run: usize,
    /// Samples between successive vectors.
    hop: usize,
}

impl<const SUMS: usize> Pass<SUMS> {
    fn new(half: &[f64], columns: usize, run: usize, hop: usize) -> Self {
        let zeros = (SUMS - 1) * hop;
        let mut response = vec![0.0; zeros];
        response.extend(half.iter().rev());
        response.extend(&half[1..]);
        response.resize(response.len() + zeros, 0.0);
        Self {
            response,
            taps: 2 * half.len() - 1,
            columns,
            run,
            hop,
        }
    }

    /// Filters the numbers whose windows begin with `signal`.
    #[inline(always)]
    fn apply<const FUSED: bool>(&self, signal: &[f64], target: &mut [f64]) {
        let numbers = self.run * self.columns;
        let vectors = target.len().div_ceil(numbers);
        let tiled = vectors - vectors % SUMS;
        let mut column = 0;
        while column < numbers {
            let width = match numbers - column {
                ..=4 => 4,
                5..=8 => 8,
                _ => WIDTH,
            };
            for k in (0..tiled).step_by(SUMS) {
                let place = (k, column);
                match width {
                    4 => self.tile::<FUSED, 4, SUMS>(signal, target, place),
                    8 => self.tile::<FUSED, 8, SUMS>(signal, target, place),
                    _ => self.tile::<FUSED, WIDTH, SUMS>(signal, target, place),
                }
            }
            for k in tiled..vectors {
                self.tile::<FUSED, WIDTH, 1>(signal, target, (k, column));
            }
            column += width;
        }
    }

    /// Computes the vectors from number `k` on.
    #[inline(always)]
    fn tile<const FUSED: bool, const NUMBERS: usize, const VECTORS: usize>(
        &self,
        signal: &[f64],
        target: &mut [f64],
        (k, column): (usize, usize),
    ) {
        let mut results = [0.0; WIDTH * TILE_SUMS[1]];
        let window = &signal[k * self.hop * self.columns + column..];
        self.sums::<FUSED, NUMBERS, VECTORS>(window, &mut results);
        let numbers = self.run * self.columns;
        for (v, sums) in results.chunks_exact(NUMBERS).take(VECTORS).enumerate() {
            let start = (k + v) * numbers + column;
            let stop = (start + NUMBERS)
                .min((k + v + 1) * numbers)
                .min(target.len());
            target[start..stop].copy_from_slice(&sums[..stop - start]);
        }
    }

    /// Computes the sums over the response for vectors at the beginning of a signal.
    #[inline(always)]
    fn sums<const FUSED: bool, const NUMBERS: usize, const VECTORS: usize>(
        &self,
        signal: &[f64],
        results: &mut [f64],
    ) {
        // registers, because all indices are constants
        let mut sums = [[0.0; NUMBERS]; VECTORS];
        let weights = &self.response[(SUMS - VECTORS) * self.hop..];
        for i in 0..self.taps + (VECTORS - 1) * self.hop {
            let numbers: &[f64; NUMBERS] = signal[i * self.columns..][..NUMBERS]
                .try_into()
                .expect("NUMBERS numbers");
            for v in 0..VECTORS {
                let weight = weights[i + (VECTORS - 1 - v) * self.hop];
                for j in 0..NUMBERS {
                    sums[v][j] = multiply_add::<FUSED>(weight, numbers[j], sums[v][j]);
                }
            }
        }
        for v in 0..VECTORS {
            results[v * NUMBERS..][..NUMBERS].copy_from_slice(&sums[v]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The definition, term by term; sums in another order differ by rounding.
        #[test]
        fn sums_are_those_of_the_definition(
            columns in 1usize..40,
            reach in 0usize..6,
            step in 1usize..4,
            count in 0usize..50,
            beyond in 0usize..9,
            seed in prop::collection::vec(-1.0..1.0f64, 7),
        ) {
            let samples = Samples { first: beyond, step, count };
            let n = (beyond + count * step).max(reach + 1);
            let value = |k: usize| seed[k % 7] + (k as f64).sin();
            let signal: Vec<f64> = (0..n * columns).map(value).collect();
            let response: Vec<f64> = (0..=reach).map(|k| seed[k % 7] / (1 + k) as f64).collect();
            let filtered = filter(&signal, columns, &response, samples);
            prop_assert_eq!(filtered.len(), count * columns);
            let sample = |at: isize, j: usize| {
                let number = |k: isize| signal[k as usize * columns + j];
                let last = n as isize - 1;
                match at {
                    ..0 => 2.0 * number(0) - number(-at),
                    _ if at > last => 2.0 * number(last) - number(2 * last - at),
                    _ => number(at),
                }
            };
            for (k, row) in filtered.chunks_exact(columns).enumerate() {
                for (j, &number) in row.iter().enumerate() {
                    let at = (samples.first + k * step) as isize;
                    let reach = reach as isize;
                    let term = |i: isize| response[i.unsigned_abs()] * sample(at + i, j);
                    let expected: f64 = (-reach..=reach).map(term).sum();
                    prop_assert!((number - expected).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn samples_are_within_the_signal() {
        let samples = Samples {
            first: 2,
            step: 3,
            count: 2,
        };
        assert!(samples.fit(6));
        assert!(!samples.fit(5));
        assert!(
            Samples {
                count: 0,
                ..samples
            }
            .fit(0)
        );
    }
}
