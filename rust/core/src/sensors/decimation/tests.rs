//! Tests of the parent module.

use super::*;

/// Pseudo-random samples.
fn random_samples(count: usize) -> Vec<f64> {
    (0..count).map(|k| ((k * k) as f64).sin()).collect()
}

#[test]
fn row_is_sum_of_taps_times_samples() {
    let taps = vec![random_samples(12), random_samples(24)[12..].to_vec()];
    let decimation = Decimation::new(taps.clone(), 4).expect("three blocks");
    let samples = random_samples(30);
    assert_eq!(decimation.rows(30), 5);
    assert_eq!(decimation.rows(11), 0);
    for (k, taps) in taps.iter().enumerate() {
        let rows = decimation.of::<f64>(k, &samples, 1);
        for (r, row) in rows.iter().enumerate() {
            let sum: f64 = (0..12).map(|t| taps[t] * samples[4 * r + t]).sum();
            assert!((row - sum).abs() < 1e-13);
        }
    }
}

#[test]
fn decimator_agrees_with_decimation() {
    let decimation = Decimation::new(
        vec![random_samples(12), random_samples(24)[12..].to_vec()],
        4,
    )
    .expect("whole");
    let (samples, width) = (31, 3);
    let quantities = [random_samples(93), random_samples(186)[93..].to_vec()];
    let expected: Vec<Vec<f64>> = (0..2)
        .map(|k| decimation.of::<f64>(k, &quantities[k], width))
        .collect();
    let mut decimated = Decimator::new(&decimation, width, samples);
    let mut row = 0;
    for s in 0..samples {
        let sample = |k: usize| &quantities[k][s * width..][..width];
        if let Some(actual) = decimated.push::<f64>(&[sample(0), sample(1)].concat()) {
            for k in 0..2 {
                for i in 0..width {
                    let error = actual[k * width + i] - expected[k][row * width + i];
                    assert!(error.abs() < 1e-13);
                }
            }
            row += 1;
        }
    }
    assert_eq!(row, decimation.rows(samples));
}

#[test]
fn mismatched_sizes_are_rejected() {
    assert!(Decimation::new(vec![random_samples(12), random_samples(8)], 4).is_none());
    assert!(Decimation::new(vec![random_samples(10)], 4).is_none());
    assert!(Decimation::new(vec![random_samples(10)], 0).is_none());
    assert!(Decimation::new(Vec::new(), 1).is_none());
}
