//! Basis signals of accelerometers and gyros at any place on a link.
//!
//! At r in the link's frame, an accelerometer along the unit vector c reads c [f + dw x r + w x (w x
//! r)]: f is the specific force at the frame's origin, w and dw are the link's angular velocity and
//! acceleration. Place and direction of the sensor are factors of twelve signals: f, dw and the
//! products w_i w_j. A gyro reads c w. All vectors are in the link's frame.

use std::ops::Range;

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
const RATES: usize = 12;

const FORCE_X: usize = 0;
const FORCE_Y: usize = 1;
const TURNING: usize = 5;
const SQUARE: usize = 8;
const RATE: usize = 14;

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

/// A sensor on each link: an accelerometer or gyro at any place, as the same weighted sum of the
/// link's signals at all times.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkSensor {
    /// Whether it reads rates, behind the low-pass of gyros instead of accelerometers.
    pub is_gyro: bool,
    /// Weights of the signals for each link. Those of the other kind of sensor are not used.
    pub weights: Vec<[f64; LINK_SIGNALS]>,
}

impl LinkSensor {
    /// The sensor on each of `joints` links that reads one of the signals.
    pub fn of_signal(signal: usize, joints: usize) -> Self {
        let mut weights = [0.0; LINK_SIGNALS];
        weights[signal] = 1.0;
        Self {
            is_gyro: signal >= RATES,
            weights: vec![weights; joints],
        }
    }

    /// The signals that it may read.
    #[inline(always)]
    pub(crate) fn signals(&self) -> Range<usize> {
        if self.is_gyro {
            RATES..LINK_SIGNALS
        } else {
            0..RATES
        }
    }

    /// Reading on link `i` before any low-pass.
    #[inline(always)]
    pub(crate) fn read<R: Real, const N: usize>(
        &self,
        i: usize,
        signals: &[[R; N]; LINK_SIGNALS],
    ) -> R {
        let mut reading = R::splat(0.0);
        for k in self.signals() {
            reading = R::splat(self.weights[i][k]).mul_add(signals[k][i], reading);
        }
        reading
    }
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
