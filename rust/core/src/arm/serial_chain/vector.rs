//! Vectors and rotations in space.

use crate::scalar::Real;

/// A vector.
pub(super) type Vector<R> = [R; 3];
/// A matrix, row by row.
pub(super) type Matrix<R> = [[R; 3]; 3];

#[inline(always)]
pub(super) fn splat<R: Real>(a: &Vector<f64>) -> Vector<R> {
    [R::splat(a[0]), R::splat(a[1]), R::splat(a[2])]
}

#[inline(always)]
pub(super) fn plus<R: Real>(a: &Vector<R>, b: &Vector<R>) -> Vector<R> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `s a + b`.
#[inline(always)]
pub(super) fn scaled<R: Real>(s: R, a: &Vector<R>, b: &Vector<R>) -> Vector<R> {
    [
        s.mul_add(a[0], b[0]),
        s.mul_add(a[1], b[1]),
        s.mul_add(a[2], b[2]),
    ]
}

#[inline(always)]
pub(super) fn dot<R: Real>(a: &Vector<R>, b: &Vector<R>) -> R {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
pub(super) fn cross<R: Real>(a: &Vector<R>, b: &Vector<R>) -> Vector<R> {
    [
        a[1].mul_add(b[2], -(a[2] * b[1])),
        a[2].mul_add(b[0], -(a[0] * b[2])),
        a[0].mul_add(b[1], -(a[1] * b[0])),
    ]
}

/// `m a`.
#[inline(always)]
pub(super) fn times<R: Real>(m: &Matrix<R>, a: &Vector<R>) -> Vector<R> {
    [dot(&m[0], a), dot(&m[1], a), dot(&m[2], a)]
}

/// `m' a`.
#[inline(always)]
pub(super) fn times_transposed<R: Real>(m: &Matrix<R>, a: &Vector<R>) -> Vector<R> {
    let zero = [R::splat(0.0); 3];
    let two = scaled(a[1], &m[1], &scaled(a[2], &m[2], &zero));
    scaled(a[0], &m[0], &two)
}
