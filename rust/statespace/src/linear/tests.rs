//! Tests of the parent module.

use super::*;
use crate::model::split;
use crate::sensitivity;

/// The last shapes have more filters than lanes.
const SHAPES: [[usize; 3]; 6] = [
    [3, 2, 2],
    [2, 1, 3],
    [7, 3, 1],
    [1, 1, 1],
    [4, 2, 3],
    [2, 4, 4],
];
const LENGTHS: [usize; 2] = [170, 95];

/// Pseudo-random number between -1/2 and 1/2.
fn number(k: usize) -> f64 {
    let mixed = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / 16_777_216.0 - 0.5
}

fn samples(shape: Shape) -> Vec<f64> {
    let count = LENGTHS.iter().sum::<usize>() * (shape.inputs + shape.outputs);
    (0..count).map(|k| number(1000 + k)).collect()
}

fn model([order, inputs, outputs]: [usize; 3]) -> Model {
    let shape = Shape {
        order,
        inputs,
        outputs,
    };
    let size = shape.initial_state(LENGTHS.len()).start;
    let values = (0..size).map(|k| 1.5 / (order as f64).sqrt() * number(k));
    Model {
        shape,
        values: values.collect(),
    }
}

/// The gradient of the weighted sum of squares with respect to the estimated entries is zero.
#[test]
fn estimate_is_a_stationary_point() {
    for shape in SHAPES {
        let start = model(shape);
        let [n, m, p] = shape;
        let samples = samples(start.shape);
        let records = split(start.shape, &samples, &LENGTHS);
        let flags: Vec<bool> = (0..m).map(|j| j % 2 == 0).collect();
        for entries in [
            Entries::Plant(&flags),
            Entries::Plant(&vec![false; m]),
            Entries::InitialStates,
        ] {
            for weighted in [None, Some(1e-20)] {
                let mut solution = start.clone();
                assert!(estimate(&mut solution, &records, entries, None));
                let mut whitener = identity(p);
                if weighted.is_some() {
                    let e = predictor::innovations(&solution, &records);
                    whitener = cholesky(&predictor::covariance(&e, p), p).unwrap();
                    assert!(estimate(&mut solution, &records, entries, weighted));
                }
                let gradient =
                    sensitivity::normal_equations(&solution, &records, &whitener).gradient;
                for index in Problem::new(&start, 2, entries).indices {
                    // rounding of sums of 265 products of about one
                    assert!(
                        gradient[index].abs() < 1e-9,
                        "{n} {m} {p}: {}",
                        gradient[index]
                    );
                }
            }
        }
    }
}

/// Equal outputs have a singular covariance, so the second solution needs whitened sums.
#[test]
fn dependent_innovations_have_a_solution() {
    let mut start = model([2, 1, 2]);
    let shape = start.shape;
    start
        .values
        .copy_within(shape.c().start..shape.c().start + 2, shape.c().start + 2);
    let mut samples = samples(shape);
    samples.chunks_exact_mut(3).for_each(|z| z[2] = z[1]);
    let records = split(shape, &samples, &LENGTHS);
    let entries = Entries::Plant(&[true]);
    let mut first = start.clone();
    assert!(estimate(&mut first, &records, entries, None));
    let mut second = start;
    assert!(estimate(&mut second, &records, entries, Some(1e-20)));
    for (l, r) in first.values.iter().zip(&second.values) {
        assert!((l - r).abs() < 1e-6, "{l} {r}");
    }
}

#[test]
fn overflowing_predictor_has_no_estimate() {
    let mut unstable = model([2, 1, 1]);
    unstable.values[unstable.shape.a()].copy_from_slice(&[40.0, 0.0, 0.0, 40.0]);
    let samples = samples(unstable.shape);
    let records = split(unstable.shape, &samples, &LENGTHS);
    assert!(!estimate(
        &mut unstable,
        &records,
        Entries::Plant(&[true]),
        None
    ));
}

/// Rows without derivatives do not change an estimate of initial states: the gradient is zero.
#[test]
fn decayed_initial_states_end_the_sums() {
    let mut start = model([3, 2, 2]);
    start.values[start.shape.a()]
        .iter_mut()
        .for_each(|entry| *entry *= 0.3);
    start.values[start.shape.k()].fill(0.0);
    let samples = samples(start.shape);
    let records = split(start.shape, &samples, &LENGTHS);
    let problem = Problem::new(&start, 2, Entries::InitialStates);
    assert!(
        problem
            .sums(&start, &records, &identity(2))
            .samples
            .is_none()
    );
    for weighted in [None, Some(1e-20)] {
        assert!(estimate(
            &mut start,
            &records,
            Entries::InitialStates,
            weighted
        ));
    }
    let e = predictor::innovations(&start, &records);
    let whitener = cholesky(&predictor::covariance(&e, 2), 2).unwrap();
    let gradient = sensitivity::normal_equations(&start, &records, &whitener).gradient;
    // the whitener of the second solution differs from that of the first by its effect on it
    assert!(
        gradient[start.shape.entries()..]
            .iter()
            .all(|g| g.abs() < 1e-2)
    );
}
