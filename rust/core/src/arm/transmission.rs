//! Transmission between motors and joints. The gears' outputs n theta_M move the joints by C n
//! theta_M, and the motors carry the torques n C' T.

use std::ops::Range;

use crate::arm::{Arm, first_joints};
use crate::scalar::Real;

/// A transmission that couples joints.
#[derive(Clone, Copy, Debug)]
pub struct Transmission<const N: usize> {
    /// C.
    matrix: [[f64; N]; N],
    inverse: [[f64; N]; N],
}

impl<const N: usize> Transmission<N> {
    /// `None` if the matrix is singular to rounding.
    pub fn new(matrix: &[[f64; N]; N]) -> Option<Self> {
        let inverse = invert(matrix)?;
        Some(Self {
            matrix: *matrix,
            inverse,
        })
    }

    /// The transmission of the first joints, which is not coupled with others.
    pub(super) fn of_first_joints<const M: usize>(&self) -> Transmission<M> {
        let rows =
            |matrix: &[[f64; N]; N]| first_joints::<_, N, M>(matrix).map(|row| first_joints(&row));
        Transmission {
            matrix: rows(&self.matrix),
            inverse: rows(&self.inverse),
        }
    }
}

impl<const N: usize> Transmission<N> {
    /// Whether a motor moves further joints, or the joint of the same index has further motors.
    pub(crate) fn couples(&self, i: usize) -> bool {
        (0..N).any(|j| j != i && (self.matrix[i][j] != 0.0 || self.matrix[j][i] != 0.0))
    }
}

/// The joints that move with a motor, and the motors that move a joint: with a transmission all,
/// otherwise the one with the same index.
pub(crate) fn coupled<A: Arm<N>, const N: usize>(arm: &A, i: usize) -> Range<usize> {
    match arm.transmission() {
        Some(_) => 0..N,
        None => i..i + 1,
    }
}

/// C_ij of coupled joints and motors.
#[inline(always)]
pub(crate) fn share<A: Arm<N>, const N: usize>(arm: &A, joint: usize, motor: usize) -> f64 {
    match arm.transmission() {
        Some(transmission) => transmission.matrix[joint][motor],
        None => 1.0,
    }
}

/// Motion of a joint: the sum of C_ij f_j x_j over the motors, plus a term.
#[inline(always)]
pub(crate) fn link_of<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    joint: usize,
    factors: &[R; N],
    motors: &[R; N],
    plus: R,
) -> R {
    let Some(transmission) = arm.transmission() else {
        return factors[joint].mul_add(motors[joint], plus);
    };
    let mut sum = plus;
    for j in 0..N {
        let factor = factors[j] * transmission.matrix[joint][j];
        sum = factor.mul_add(motors[j], sum);
    }
    sum
}

/// Torsion of a gear for link-side motions of motors and links.
#[inline(always)]
pub(crate) fn torsion_of<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    joint: usize,
    motors: &[R; N],
    links: &[R; N],
) -> R {
    match arm.transmission() {
        None => motors[joint] - links[joint],
        Some(_) => link_of(arm, joint, &[R::splat(1.0); N], motors, -links[joint]),
    }
}

/// Torque on a motor: the sum of C_ij f T_i over the joints, plus a term.
#[inline(always)]
pub(crate) fn motor_of<A: Arm<N>, R: Real, const N: usize>(
    arm: &A,
    motor: usize,
    factor: R,
    torques: &[R; N],
    plus: R,
) -> R {
    let Some(transmission) = arm.transmission() else {
        return factor.mul_add(torques[motor], plus);
    };
    let mut sum = plus;
    for i in 0..N {
        let factor = factor * transmission.matrix[i][motor];
        sum = factor.mul_add(torques[i], sum);
    }
    sum
}

/// Outputs n theta_M of the gears for a motion of the joints: C^-1 q.
#[inline(always)]
pub(crate) fn outputs_of<A: Arm<N>, R: Real, const N: usize>(arm: &A, joints: &[R; N]) -> [R; N] {
    match arm.transmission() {
        Some(transmission) => {
            let mut outputs = [R::splat(0.0); N];
            for i in 0..N {
                for j in 0..N {
                    let entry = R::splat(transmission.inverse[i][j]);
                    outputs[i] = entry.mul_add(joints[j], outputs[i]);
                }
            }
            outputs
        }
        None => *joints,
    }
}

/// Inverse by elimination with pivots; `None` if a pivot vanishes to rounding.
fn invert<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut rest = *matrix;
    let mut inverse = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)));
    let size = rest
        .as_flattened()
        .iter()
        .fold(0.0f64, |a, b| a.max(b.abs()));
    for k in 0..N {
        let larger = |&a: &usize, &b: &usize| rest[a][k].abs().total_cmp(&rest[b][k].abs());
        let pivot = (k..N).max_by(larger)?;
        rest.swap(k, pivot);
        inverse.swap(k, pivot);
        let scale = 1.0 / rest[k][k];
        if !scale.is_finite() || rest[k][k].abs() <= 1e-12 * size {
            return None;
        }
        for rows in [&mut rest, &mut inverse] {
            rows[k] = rows[k].map(|entry: f64| entry * scale);
        }
        for i in (0..N).filter(|&i| i != k) {
            let factor = rest[i][k];
            for j in 0..N {
                rest[i][j] -= factor * rest[k][j];
                inverse[i][j] -= factor * inverse[k][j];
            }
        }
    }
    Some(inverse)
}

#[inline(always)]
pub(crate) fn product<R: Real, const N: usize>(matrix: &[[R; N]; N], x: &[R; N]) -> [R; N] {
    let mut all = [R::splat(0.0); N];
    for i in 0..N {
        for j in 0..N {
            all[i] = matrix[i][j].mul_add(x[j], all[i]);
        }
    }
    all
}

/// P' M P and P' b for the rigid joints' block P of C: the equations of joints behind rigid gears in
/// the outputs of the gears. No transmission couples rigid with elastic joints.
pub(crate) fn reflect<R: Real, const N: usize>(
    block: &[[R; N]; N],
    matrix: &mut [[R; N]; N],
    vector: &mut [R; N],
) {
    let (mut half, old) = ([[R::splat(0.0); N]; N], *vector);
    for i in 0..N {
        for j in 0..N {
            for k in 0..N {
                half[i][j] = matrix[i][k].mul_add(block[k][j], half[i][j]);
            }
        }
    }
    *matrix = [[R::splat(0.0); N]; N];
    *vector = [R::splat(0.0); N];
    for i in 0..N {
        for k in 0..N {
            vector[i] = block[k][i].mul_add(old[k], vector[i]);
            for j in 0..N {
                matrix[i][j] = block[k][i].mul_add(half[k][j], matrix[i][j]);
            }
        }
    }
}
