//! Tests of the parent module.

use super::*;

#[test]
fn cholesky_solves() {
    let matrix = [4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
    let factor = cholesky(&matrix, 3).unwrap();
    let mut x = vec![1.0, -2.0, 0.5];
    solve_lower(&factor, 3, &mut x);
    solve_lower_transposed(&factor, 3, &mut x);
    for (row, rhs) in matrix.chunks(3).zip([1.0, -2.0, 0.5]) {
        let product: f64 = row.iter().zip(&x).map(|(m, v)| m * v).sum();
        assert!((product - rhs).abs() < 1e-14);
    }
    assert!(cholesky(&[1.0, 1.0, 1.0, 1.0], 2).is_none());
}

#[test]
fn inverse_with_row_exchanges() {
    let matrix = vec![0.0, 2.0, 1.0, -1.0, 0.5, 0.0, 3.0, 1.0, 2.0];
    let (inverse, log_determinant) = inverse(matrix.clone(), 3).unwrap();
    for i in 0..3 {
        for j in 0..3 {
            let product: f64 = (0..3).map(|k| matrix[i * 3 + k] * inverse[k * 3 + j]).sum();
            assert!((product - f64::from(u8::from(i == j))).abs() < 1e-14);
        }
    }
    let determinant = -2.0 * (-2.0 - 0.0) + (-1.0 - 1.5);
    assert!((log_determinant - f64::ln(determinant)).abs() < 1e-14);
    assert!(super::inverse(vec![-1.0], 1).is_none());
}

#[test]
fn complement_is_orthonormal_and_orthogonal() {
    let (rows, columns) = (5, 2);
    let matrix = vec![1.0, 2.0, 0.0, 1.0, -1.0, 3.0, 2.0, 0.5, 0.1, 0.0];
    let basis = orthogonal_complement(matrix.clone(), rows, columns);
    let width = rows - columns;
    for i in 0..width {
        for j in 0..width {
            let product: f64 = (0..rows)
                .map(|r| basis[r * width + i] * basis[r * width + j])
                .sum();
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((product - expected).abs() < 1e-14);
        }
        for j in 0..columns {
            let product: f64 = (0..rows)
                .map(|r| basis[r * width + i] * matrix[r * columns + j])
                .sum();
            assert!(product.abs() < 1e-14);
        }
    }
}
