//! The links' equations of motion, one implementation per arm.
//!
//! An arm is what stands on the link side of (2): inertia matrix, velocity torques, gravity, and what
//! sensors on its links read. To add another, implement [`Arm`] for it in a file here; the
//! integrator, the gears, the friction, the servo and the sensitivities take it as it is. What they
//! need of derivatives by the motion comes from the equations over numbers with a derivative, unless
//! the arm has a closed form that is faster.

mod differentiation;
pub mod link_signals;
mod one_link;
mod serial_chain;
mod turn;
mod two_link;

pub use one_link::OneLink;
pub use serial_chain::{ChainJoint, JointType, SerialChain};
pub use two_link::TwoLink;

use crate::parameter::Parameter;
use crate::scalar::Real;
use link_signals::{LINK_SIGNALS, LinkSignalSlopes};

/// A parameter's name, and its joint, from 1, where it belongs to one.
pub type Name = (&'static str, Option<usize>);

/// An arm of `N` joints: the value holds what is known of it, its geometry.
pub trait Arm<const N: usize>: Copy + Send + Sync + 'static {
    /// Inertial and gravity parameters, in the order of [`Arm::names`].
    type Base<R: Real>: Copy + Send + Sync;
    /// What the equations need of the joint angles: sines and cosines.
    type Posture<R: Real>: Copy;
    /// Torques [N m] of every joint for each of the base parameters.
    type Regressor<R: Real>: AsRef<[[R; N]]>;

    /// Whether anything depends on each joint's angle: the first of a horizontal arm is not felt.
    const FELT: [bool; N];
    /// Whether all axes are parallel. Each link's rate in space is then the sum of the joints' rates
    /// up to its own, and its accelerometer does not feel how fast its own joint turns.
    const PLANAR: bool;
    /// Whether one compiled program per kind of processor has to do: arms then run one at a time,
    /// and rigid gears and effects cost their branches also where there are none.
    const COMPACT: bool = false;

    /// The base parameters, each once: of a chain those of one link.
    const PARAMETERS: &'static [Parameter];

    /// Names of the base parameters, as docs/notation.md has them; the joint, from 1, where one
    /// belongs to a joint.
    fn names(&self) -> Vec<Name>;
    /// Checks finite values of the base parameters: the inertia matrix must be positive definite at
    /// every posture. `reflected` [kg m^2] is the inertia that motors behind rigid gears add.
    ///
    /// # Errors
    /// The place of the first value that no arm can have, and what it must be.
    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; N],
    ) -> Result<(), (usize, &'static str)>;
    /// Base parameters from a flat list in the order of [`Arm::names`].
    fn base<R: Real>(&self, values: &[R]) -> Self::Base<R>;
    /// The base parameters, each put through a function.
    fn map_base<R: Real, L: Real>(base: &Self::Base<R>, to: impl Fn(R) -> L) -> Self::Base<L>;

    /// Sines and cosines of a posture.
    fn posture<R: Real>(&self, q: &[R; N]) -> Self::Posture<R>;
    /// Sines and cosines a little further on: exact to rounding for less than 0.05 rad, the
    /// rotation within one step of the integrator.
    fn near<R: Real>(&self, from: &Self::Posture<R>, increment: &[R; N]) -> Self::Posture<R>;
    /// A posture, each of its numbers put through a function.
    fn map_posture<R: Real, L: Real>(
        at: &Self::Posture<R>,
        to: impl Fn(R) -> L,
    ) -> Self::Posture<L>;

    /// Inertia matrix M_L(q) [kg m^2], symmetric and positive definite.
    fn inertia<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>) -> [[R; N]; N];
    /// Centrifugal, Coriolis and gravity torques c(q, dq) + g(q) [N m].
    fn bias<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// How M_L(q) ddq + c + g depends on the base parameters, for each of [`Arm::names`].
    fn regressor<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> Self::Regressor<R>;
    /// Potential energy of gravity [J], from a height that is the arm's own.
    fn potential<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>) -> R;

    /// Tangential reading [m/s^2] of an accelerometer on each link, (8) and (9) in general form,
    /// gravity's part included: sensors read specific force.
    fn accelerometers<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N], ddq: &[R; N]) -> [R; N];
    /// Rate of each link in space [rad/s] about its own axis, as a gyro on it reads.
    fn absolute_rates<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// What any accelerometer on a link reads a linear combination of, see [`link_signals`].
    fn link_signals<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [[R; N]; LINK_SIGNALS];

    /// M_L(q) ddq + c + g [N m].
    #[inline(always)]
    fn torques<R: Real>(
        &self,
        base: &Self::Base<R>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N] {
        let inertia = self.inertia(base, at);
        let mut torque = self.bias(base, at, dq);
        for i in 0..N {
            for j in 0..N {
                torque[i] = inertia[i][j].mul_add(ddq[j], torque[i]);
            }
        }
        torque
    }

    /// How [`Arm::torques`] depend on angles and velocities.
    #[inline(always)]
    fn slopes<R: Real>(
        &self,
        base: &Self::Base<R>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> Slopes<R, N> {
        differentiation::slopes(self, base, (at, dq, ddq))
    }
    /// How [`Arm::accelerometers`] depend on angles and velocities, and on the accelerations.
    ///
    /// A sensor feels the joints up to its own: all other entries are zero, and are not looked at.
    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> (Slopes<R, N>, [[R; N]; N]) {
        differentiation::accelerometer_slopes(self, (at, dq, ddq))
    }
    /// How [`Arm::absolute_rates`] depend on angles and velocities.
    #[inline(always)]
    fn rate_slopes<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N]) -> Slopes<R, N> {
        differentiation::rate_slopes(self, at, dq)
    }
    /// How [`Arm::link_signals`] depend on angles, velocities and accelerations.
    #[inline(always)]
    fn link_signal_slopes<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [LinkSignalSlopes<R, N>; N] {
        differentiation::link_signal_slopes(self, (at, dq, ddq))
    }
}

/// One in a plane of motion with gravity, and zero in a horizontal one.
#[inline(always)]
fn has_gravity(gravity: f64) -> f64 {
    if gravity == 0.0 { 0.0 } else { 1.0 }
}

/// Derivatives of one vector by the joint angles and by the joint velocities, rows by columns.
#[derive(Clone, Copy, Debug)]
pub struct Slopes<R, const N: usize> {
    /// By the angles; zero for those that are not [`Arm::FELT`].
    pub angle: [[R; N]; N],
    /// By the velocities.
    pub velocity: [[R; N]; N],
}
