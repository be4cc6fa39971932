//! Basis signals of accelerometers and gyros at any place on a link.
//!
//! At r in the link's frame, an accelerometer along the unit vector c reads c [f + dw x r + w x (w x
//! r)]: f is the specific force at the frame's origin, w and dw are the link's angular velocity and
//! acceleration. Place and direction of the sensor are factors of twelve signals: f, dw and the
//! products w_i w_j. A gyro reads c w. All vectors are in the link's frame.

use crate::scalar::Real;

/// Number of signals of a link.
pub const LINK_SIGNALS: usize = 15;

/// Names of the signals: f [m/s^2], dw [rad/s^2], w_i w_j [rad^2/s^2], w [rad/s].
pub const NAMES: [&str; LINK_SIGNALS] = [
    "specific_force_x",
    "specific_force_y",
    "specific_force_z",
    "angular_acceleration_x",
    "angular_acceleration_y",
    "angular_acceleration_z",
    "rate_product_xx",
    "rate_product_yy",
    "rate_product_zz",
    "rate_product_xy",
    "rate_product_xz",
    "rate_product_yz",
    "angular_rate_x",
    "angular_rate_y",
    "angular_rate_z",
];

/// The first signal of gyros; those before it are signals of accelerometers.
pub(crate) const RATES: usize = 12;

/// All signals.
pub(super) const ALL: &[usize] = &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14];
/// Signals of a planar arm, which moves in the plane across z; the others are zero.
pub(super) const PLANAR: &[usize] = &[FORCE_X, FORCE_Y, TURNING, SQUARE, RATE];

const FORCE_X: usize = 0;
const FORCE_Y: usize = 1;
const TURNING: usize = 5;
const SQUARE: usize = 8;
/// The rate about z.
pub(crate) const RATE: usize = 14;

/// Signals of a link from f, dw and w.
#[inline(always)]
pub(super) fn of_link<R: Real>([f, dw, w]: [[R; 3]; 3]) -> [R; LINK_SIGNALS] {
    let [x, y, z] = w;
    let products = [x * x, y * y, z * z, x * y, x * z, y * z];
    let mut all = [R::splat(0.0); LINK_SIGNALS];
    all[..3].copy_from_slice(&f);
    all[3..6].copy_from_slice(&dw);
    all[6..RATES].copy_from_slice(&products);
    all[RATES..].copy_from_slice(&w);
    all
}

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
    all[TURNING] = summed(ddq);
    all[RATE] = rates;
    for i in 0..N {
        let (sin, cos) = space[i];
        (all[FORCE_X][i], all[FORCE_Y][i]) = (g * sin, g * cos);
        all[SQUARE][i] = rates[i] * rates[i];
        if i > 0 {
            let (sin, cos) = joint[i];
            let (across, inward) = (length * ddq[0], length * (dq[0] * dq[0]));
            all[FORCE_X][i] = all[FORCE_X][i] + (across * sin - inward * cos);
            all[FORCE_Y][i] = all[FORCE_Y][i] + (across * cos + inward * sin);
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
            slopes.acceleration[TURNING][j] = R::splat(1.0);
            slopes.velocity[SQUARE][j] = rates[i] + rates[i];
            slopes.velocity[RATE][j] = R::splat(1.0);
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
