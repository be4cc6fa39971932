//! Derivatives of an arm's equations with respect to the motion, by forward differentiation with
//! [`Jet`]s.

use super::{Arm, Slopes};
use crate::scalar::{Jet, Real};

/// A posture, velocities and accelerations.
type Motion<'a, P, R, const N: usize> = (&'a P, &'a [R; N], &'a [R; N]);

/// Default of [`Arm::slopes`].
#[inline(always)]
pub(super) fn slopes<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    base: &A::Base<R>,
    motion: Motion<'_, A::Posture<R>, R, N>,
) -> Slopes<R, N> {
    let base = A::map_base(base, Jet::constant);
    let [[angle], [velocity]] =
        differentiate(arm, motion, |at, dq, ddq| [arm.torques(&base, at, dq, ddq)]);
    Slopes { angle, velocity }
}

/// Default of [`Arm::accelerometer_slopes`].
#[inline(always)]
pub(super) fn accelerometer_slopes<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    motion: Motion<'_, A::Posture<R>, R, N>,
) -> (Slopes<R, N>, [[R; N]; N]) {
    let [[angle], [velocity], [acceleration]] =
        differentiate(arm, motion, |at, dq, ddq| [arm.accelerometers(at, dq, ddq)]);
    (Slopes { angle, velocity }, acceleration)
}

/// Default of [`Arm::rate_slopes`].
#[inline(always)]
pub(super) fn rate_slopes<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    at: &A::Posture<R>,
    dq: &[R; N],
) -> Slopes<R, N> {
    let [[angle], [velocity]] =
        differentiate(arm, (at, dq, dq), |at, dq, _| [arm.absolute_rates(at, dq)]);
    Slopes { angle, velocity }
}

/// Derivatives of functions of the motion with respect to angles, velocities and, if `K` is 3,
/// accelerations.
type Derivatives<R, const N: usize, const M: usize, const K: usize> = [[[[R; N]; N]; M]; K];

/// Derivatives of `M` functions of the motion with a value for each joint: evaluates them over
/// [`Jet`]s once for each joint.
#[inline(always)]
fn differentiate<A: Arm<N>, R: Real, const N: usize, const M: usize, const K: usize>(
    arm: &A,
    (at, dq, ddq): Motion<'_, A::Posture<R>, R, N>,
    functions: impl Fn(&A::Posture<Jet<R>>, &[Jet<R>; N], &[Jet<R>; N]) -> [[Jet<R>; N]; M],
) -> Derivatives<R, N, M, K> {
    let (zero, one) = (R::splat(0.0), R::splat(1.0));
    let at = A::map_posture(at, Jet::constant);
    let mut all = [[[[zero; N]; N]; M]; K];
    for j in 0..arm.joints() {
        for (kind, by) in all.iter_mut().enumerate() {
            let mut motion = [[Jet::constant(zero); N]; 3];
            for i in 0..arm.joints() {
                (motion[1][i].value, motion[2][i].value) = (dq[i], ddq[i]);
            }
            motion[kind][j].tangent = one;
            let [increment, dq, ddq] = motion;
            let values = functions(&arm.near(&at, &increment), &dq, &ddq);
            for m in 0..M {
                for i in 0..arm.joints() {
                    by[m][i][j] = values[m][i].tangent;
                }
            }
        }
    }
    all
}

#[cfg(test)]
mod tests;
