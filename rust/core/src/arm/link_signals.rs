//! Basis signals of an accelerometer at any position on a link of a planar arm.
//!
//! At (x, y) in the link's frame, along the direction c in that plane, an accelerometer reads c_x
//! (f_x - alpha y - w^2 x) + c_y (f_y + alpha x - w^2 y): f is the specific force at the link's own
//! axis, alpha and w are the link's angular acceleration and rate in space. Position and direction
//! of the sensor appear in the four factors only.

use crate::scalar::Real;

/// f_x, f_y [m/s^2], alpha [rad/s^2] and w^2 [rad^2/s^2] of each link.
pub const LINK_SIGNALS: usize = 4;

/// Derivatives of the signals of one link with respect to the motion of each joint.
#[derive(Clone, Copy, Debug)]
pub struct LinkSignalSlopes<R, const N: usize> {
    /// With respect to the angles.
    pub angle: [[R; N]; LINK_SIGNALS],
    /// With respect to the velocities.
    pub velocity: [[R; N]; LINK_SIGNALS],
    /// With respect to the accelerations.
    pub acceleration: [[R; N]; LINK_SIGNALS],
}

/// Sines and cosines of each link's angle in space, needed with gravity only, and of each joint's
/// angle, needed from the second joint on.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinkRotations<R, const N: usize> {
    /// Relative to the base's x axis.
    pub(super) space: [(R, R); N],
    /// Relative to the preceding link.
    pub(super) joint: [(R, R); N],
}

/// Rate of each link in space: the sum of the joint rates up to it.
#[inline(always)]
pub(crate) fn summed<R: Real, const N: usize>(rates: &[R; N]) -> [R; N] {
    let mut all = *rates;
    for i in 1..N {
        all[i] = all[i - 1] + rates[i];
    }
    all
}

/// Link signals of each link at its own axis, for at most two links. The first axis is fixed;
/// `gravity` [m/s^2] is its part in the plane of motion, `length` [m] the distance of the axes.
#[inline(always)]
pub(super) fn planar<R: Real, const N: usize>(
    LinkRotations { space, joint }: &LinkRotations<R, N>,
    gravity: f64,
    length: f64,
    dq: &[R; N],
    ddq: &[R; N],
) -> [[R; N]; LINK_SIGNALS] {
    let (g, length) = (R::splat(gravity), R::splat(length));
    let rates = summed(dq);
    let mut all = [[R::splat(0.0); N]; LINK_SIGNALS];
    all[2] = summed(ddq);
    for i in 0..N {
        let (sin, cos) = space[i];
        (all[0][i], all[1][i]) = (g * sin, g * cos);
        all[3][i] = rates[i] * rates[i];
        if i > 0 {
            let (sin, cos) = joint[i];
            let (across, inward) = (length * ddq[0], length * (dq[0] * dq[0]));
            all[0][i] = all[0][i] + (across * sin - inward * cos);
            all[1][i] = all[1][i] + (across * cos + inward * sin);
        }
    }
    all
}

/// Derivatives of the [`planar`] signals with respect to angles, velocities and accelerations.
#[inline(always)]
pub(super) fn planar_slopes<R: Real, const N: usize>(
    LinkRotations { space, joint }: &LinkRotations<R, N>,
    gravity: f64,
    length: f64,
    dq: &[R; N],
    ddq: &[R; N],
) -> [LinkSignalSlopes<R, N>; N] {
    let zero = R::splat(0.0);
    let (g, length) = (R::splat(gravity), R::splat(length));
    let rates = summed(dq);
    let zeros = LinkSignalSlopes {
        angle: [[zero; N]; LINK_SIGNALS],
        velocity: [[zero; N]; LINK_SIGNALS],
        acceleration: [[zero; N]; LINK_SIGNALS],
    };
    let mut all = [zeros; N];
    for i in 0..N {
        let (sin, cos) = space[i];
        let slopes = &mut all[i];
        for j in 0..=i {
            (slopes.angle[0][j], slopes.angle[1][j]) = (g * cos, -(g * sin));
            slopes.acceleration[2][j] = R::splat(1.0);
            slopes.velocity[3][j] = rates[i] + rates[i];
        }
        if i > 0 {
            let (sin, cos) = joint[i];
            let (across, inward) = (length * ddq[0], length * (dq[0] * dq[0]));
            let twice = length * (dq[0] + dq[0]);
            slopes.angle[0][i] = slopes.angle[0][i] + (across * cos + inward * sin);
            slopes.angle[1][i] = slopes.angle[1][i] + (inward * cos - across * sin);
            (slopes.velocity[0][0], slopes.velocity[1][0]) = (-(twice * cos), twice * sin);
            (slopes.acceleration[0][0], slopes.acceleration[1][0]) = (length * sin, length * cos);
        }
    }
    all
}
