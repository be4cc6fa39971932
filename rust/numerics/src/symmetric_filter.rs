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
    /// Whether a signal of `length` samples reaches `reach` samples beyond all of them.
    pub fn fit(self, length: usize, reach: usize) -> bool {
        let last = self.first + self.count.saturating_sub(1) * self.step;
        self.count == 0 || (self.first >= reach && last + reach < length)
    }
}

/// Filtered samples, (count, columns), of a signal (n, columns).
///
/// `response` is the impulse response at the impulse and at later samples; it is the same at
/// earlier ones. Panics if the signal ends within the response of a sample.
pub fn filter(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    assert!(samples.fit(signal.len() / columns, response.len() - 1));
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: all features have just been detected.
            return unsafe { filter_avx512(signal, columns, response, samples) };
        }
        // SAFETY: both features have just been detected.
        return unsafe { filter_avx2(signal, columns, response, samples) };
    }
    filter_with::<BASELINE_IS_FUSED>(signal, columns, response, samples)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f")]
fn filter_avx512(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    filter_with::<true>(signal, columns, response, samples)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn filter_avx2(signal: &[f64], columns: usize, response: &[f64], samples: Samples) -> Vec<f64> {
    filter_with::<true>(signal, columns, response, samples)
}

#[inline(always)]
fn filter_with<const FUSED: bool>(
    signal: &[f64],
    columns: usize,
    response: &[f64],
    samples: Samples,
) -> Vec<f64> {
    let Samples { first, step, count } = samples;
    let mut result = vec![0.0; count * columns];
    // successive samples are one run of numbers
    let run = if step == 1 { count * columns } else { columns };
    for (k, target) in result.chunks_exact_mut(run.max(1)).enumerate() {
        let at = (first + k * step) * columns;
        let mut done = 0;
        for (width, least) in [(16, 9), (8, 5), (4, 3), (2, 2), (1, 1)] {
            // more numbers than needed cost nothing
            let beyond = at + (response.len() - 1) * columns + width;
            while target.len() - done >= least && done + beyond <= signal.len() {
                let place = (signal, columns, response, at + done);
                let target = &mut target[done..];
                done += match width {
                    16 => sums::<FUSED, 16>(place, target),
                    8 => sums::<FUSED, 8>(place, target),
                    4 => sums::<FUSED, 4>(place, target),
                    2 => sums::<FUSED, 2>(place, target),
                    _ => sums::<FUSED, 1>(place, target),
                };
            }
        }
    }
    result
}

/// Computes the first `WIDTH` numbers of a run, in registers; the number of those needed.
#[inline(always)]
fn sums<const FUSED: bool, const WIDTH: usize>(
    (signal, columns, response, here): (&[f64], usize, &[f64], usize),
    target: &mut [f64],
) -> usize {
    let reach = (response.len() - 1) * columns;
    let (earlier, later) = (&signal[here - reach..], &signal[here..]);
    let numbers = |part: &[f64], start: usize| -> [f64; WIDTH] {
        part[start..start + WIDTH]
            .try_into()
            .expect("WIDTH numbers")
    };
    let mut total = numbers(later, 0).map(|value| response[0] * value);
    let mut second = [0.0; WIDTH];
    let add = |sum: &mut [f64; WIDTH], away: usize, weight: f64| {
        let (before, after) = (numbers(earlier, reach - away), numbers(later, away));
        for i in 0..WIDTH {
            sum[i] = multiply_add::<FUSED>(weight, before[i] + after[i], sum[i]);
        }
    };
    let (pairs, rest) = response[1..].as_chunks::<2>();
    let mut away = columns;
    for [weight, next] in pairs {
        add(&mut total, away, *weight);
        add(&mut second, away + columns, *next);
        away += 2 * columns;
    }
    for weight in rest {
        add(&mut total, away, *weight);
    }
    let needed = WIDTH.min(target.len());
    for (target, (one, other)) in target.iter_mut().zip(total.iter().zip(second)) {
        *target = one + other;
    }
    needed
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
            count in 0usize..9,
            seed in prop::collection::vec(-1.0..1.0f64, 7),
        ) {
            let samples = Samples { first: reach + 1, step, count };
            let n = samples.first + count * step + reach;
            let value = |k: usize| seed[k % 7] + (k as f64).sin();
            let signal: Vec<f64> = (0..n * columns).map(value).collect();
            let response: Vec<f64> = (0..=reach).map(|k| seed[k % 7] / (1 + k) as f64).collect();
            let filtered = filter(&signal, columns, &response, samples);
            prop_assert_eq!(filtered.len(), count * columns);
            for (k, row) in filtered.chunks_exact(columns).enumerate() {
                for (j, &number) in row.iter().enumerate() {
                    let at = samples.first + k * step;
                    let term = |i: usize| {
                        response[at.abs_diff(i)] * signal[i * columns + j]
                    };
                    let expected: f64 = (at - reach..=at + reach).map(term).sum();
                    prop_assert!((number - expected).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_signal_must_reach_beyond_the_samples() {
        let samples = Samples {
            first: 2,
            step: 3,
            count: 2,
        };
        assert!(samples.fit(8, 2));
        assert!(!samples.fit(7, 2));
        assert!(!samples.fit(9, 3));
        assert!(
            Samples {
                count: 0,
                ..samples
            }
            .fit(0, 3)
        );
    }
}
