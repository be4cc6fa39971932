//! Tests of the parent module.

use super::*;

#[test]
fn barrier_slope_and_curvature_of_one_pole() {
    let shape = Shape {
        order: 1,
        inputs: 1,
        outputs: 1,
    };
    let at = |a: f64, c: f64, k: f64| Model {
        shape,
        values: vec![a, 1.0, c, 0.0, k, 0.0],
    };
    let model = at(0.95, 0.5, 0.3);
    let barrier = Barrier::at(&model.predictor_matrix(), model.shape.order).unwrap();
    let pole = 0.95_f64 - 0.3 * 0.5;
    assert!((barrier.value + 0.5 * (1.0 - pole * pole).ln()).abs() < 1e-14);
    let slope = pole / (1.0 - pole * pole);
    let mut change = vec![0.0; 6];
    change[2] = 1.0; // entry of C
    let moved = predictor_change(&model, &change);
    for definite in [false, true] {
        let (gradient, curvature) = barrier.along(std::slice::from_ref(&moved), definite);
        assert!((gradient[0] + 0.3 * slope).abs() < 1e-13);
        assert!((curvature[0] - 2.0 * (0.3 * slope).powi(2)).abs() < 1e-13);
    }
    assert!(Barrier::at(&at(1.2, 0.5, 0.3).predictor_matrix(), 1).is_none());
}

#[test]
fn barrier_slope_matches_differences() {
    let shape = Shape {
        order: 3,
        inputs: 1,
        outputs: 1,
    };
    let mut values = vec![0.6, 0.5, 0.1, -0.5, 0.7, 0.2, 0.3, -0.1, 0.8];
    values.extend([1.0, 0.0, 0.0, 0.3, -0.2, 0.5, 0.0, 0.2, 0.1, 0.1]);
    let model = Model { shape, values };
    let barrier = Barrier::at(&model.predictor_matrix(), model.shape.order).unwrap();
    for entry in 0..model.values.len() {
        let mut change = vec![0.0; model.values.len()];
        change[entry] = 1.0;
        let (gradient, _) = barrier.along(&[predictor_change(&model, &change)], false);
        let shifted = |step: f64| {
            let mut other = model.clone();
            other.values[entry] += step;
            Barrier::at(&other.predictor_matrix(), 3).unwrap().value
        };
        let difference = (shifted(1e-5) - shifted(-1e-5)) / 2e-5;
        assert!((gradient[0] - difference).abs() < 1e-7 * (1.0 + difference.abs()));
    }
}

#[test]
fn curvature_is_half_the_trace_of_products_of_relative_changes() {
    let f = [0.6, 0.5, 0.1, -0.5, 0.7, 0.2, 0.3, -0.1, 0.8].map(|entry| 0.7 * entry);
    let (n, size) = (3, 9);
    let barrier = Barrier::at(&f, n).unwrap();
    // the matrix is quadratic in each entry, so that differences are exact
    let kronecker = |f: &[f64]| -> Vec<f64> {
        (0..size * size)
            .map(|at| {
                let (row, column) = (at / size, at % size);
                let one = f64::from(u8::from(row == column));
                one - f[row / n * n + column / n] * f[row % n * n + column % n]
            })
            .collect()
    };
    let (inverse, _) = inverse(kronecker(&f), size).unwrap();
    let relative: Vec<Vec<f64>> = (0..size)
        .map(|entry| {
            let mut moved = [f, f];
            moved[0][entry] += 0.5;
            moved[1][entry] -= 0.5;
            let [up, down] = moved.map(|f| kronecker(&f));
            (0..size * size)
                .map(|at| {
                    let (row, column) = (at / size, at % size);
                    (0..size)
                        .map(|k| {
                            let change = up[k * size + column] - down[k * size + column];
                            inverse[row * size + k] * change
                        })
                        .sum()
                })
                .collect()
        })
        .collect();
    for a in 0..size {
        for b in 0..size {
            let trace: f64 = (0..size * size)
                .map(|at| relative[a][at] * relative[b][at % size * size + at / size])
                .sum();
            let unit = |entry: usize| (0..size).map(|k| f64::from(u8::from(k == entry))).collect();
            let (_, curvature) = barrier.along(&[unit(a), unit(b)], false);
            assert!((curvature[1] - 0.5 * trace).abs() < 1e-12 * (1.0 + trace.abs()));
        }
    }
}

fn spiral(radius: f64, angle: f64) -> [f64; 4] {
    let (sin, cos) = angle.sin_cos();
    [radius * cos, -radius * sin, radius * sin, radius * cos]
}

#[test]
fn distinguishes_stable_from_unstable() {
    for gap in [0.5, 1e-3, 1e-6, 1e-9] {
        assert!(is_stable(&spiral(1.0 - gap, 0.3), 2), "{gap}");
        assert!(!is_stable(&spiral(1.0 + gap, 0.3), 2), "{gap}");
    }
    assert!(!is_stable(&[1.0], 1));
}

#[test]
fn transient_growth_is_stable() {
    assert!(is_stable(&[0.9, 1e6, 0.0, 0.9], 2));
    assert!(!is_stable(&[f64::NAN], 1));
}
