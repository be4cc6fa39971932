//! The links' equations of motion, one implementation per arm.
//!
//! An arm is what stands on the link side of (2): inertia matrix, velocity torques, gravity. To add
//! another, implement [`Arm`] for it here; the integrator, the gears, the friction and the tests'
//! harness take it as it is.

pub mod link_signals;
mod one_link;
mod turn;
mod two_link;

pub use one_link::OneLink;
pub use two_link::TwoLink;

use crate::scalar::Real;

/// An arm of `N` links with revolute joints, or a single prismatic one.
pub trait Arm<const N: usize>: Copy + Send + Sync + 'static {
    /// Inertial and gravity parameters, in the order of [`Arm::NAMES`].
    type Base<R: Real>: Copy + Send + Sync;
    /// What the equations need of the joint angles: sines and cosines.
    type Posture<R: Real>: Copy;

    /// Names of the base parameters, as docs/notation.md has them; the joint, from 1, where one
    /// belongs to a joint.
    const NAMES: &'static [(&'static str, Option<usize>)];
    /// Whether anything depends on each joint's angle: the first of a horizontal arm is not felt.
    const FELT: [bool; N];

    /// Base parameters from a flat list in the order of [`Arm::NAMES`].
    fn base<R: Real>(values: &[R]) -> Self::Base<R>;
    /// Sines and cosines of a posture.
    fn posture<R: Real>(q: &[R; N]) -> Self::Posture<R>;
    /// Sines and cosines a little further on: exact to rounding for less than 0.05 rad, the
    /// rotation within one step of the integrator.
    fn near<R: Real>(from: &Self::Posture<R>, increment: &[R; N]) -> Self::Posture<R>;
    /// The same posture in every lane of another scalar.
    fn spread<R: Real, L: Real>(at: &Self::Posture<R>) -> Self::Posture<L>;
    /// Inertia matrix M_L(q) [kg m^2], symmetric and positive definite.
    fn inertia<R: Real>(base: &Self::Base<R>, at: &Self::Posture<R>) -> [[R; N]; N];
    /// Centrifugal, Coriolis and gravity torques c(q, dq) + g(q) [N m].
    fn bias<R: Real>(base: &Self::Base<R>, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// How M_L(q) ddq + c + g depends on angles and velocities.
    fn slopes<R: Real>(
        base: &Self::Base<R>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> Slopes<R, N>;
    /// How M_L(q) ddq + c + g depends on the base parameters, for each of [`Arm::NAMES`].
    fn regressor<R: Real>(at: &Self::Posture<R>, dq: &[R; N], ddq: &[R; N]) -> [[R; N]; MOST_BASE];
    /// Potential energy of gravity [J], zero at zero angles' height.
    fn potential<R: Real>(base: &Self::Base<R>, at: &Self::Posture<R>) -> R;
    /// Tangential reading [m/s^2] of an accelerometer on each link, (8) and (9) in general form,
    /// gravity's part included: sensors read specific force.
    fn accelerometers<R: Real>(
        sensors: &Accelerometers<N>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N];
    /// How these readings depend on angles and velocities, and on the accelerations.
    ///
    /// A sensor feels the joints up to its own, and not how fast that one turns, for what it would
    /// feel of it points along the link: all other entries are zero, and are not looked at.
    fn accelerometer_slopes<R: Real>(
        sensors: &Accelerometers<N>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> (Slopes<R, N>, [[R; N]; N]);
    /// Rate of each link in space [rad/s], as a gyro on it reads.
    fn absolute_rates<R: Real>(dq: &[R; N]) -> [R; N];
    /// How the links are turned.
    fn turns<R: Real>(at: &Self::Posture<R>) -> Turns<R, N>;
}

/// Sines and cosines of each link's angle in space, which count under gravity only, and of each
/// joint's angle, which count from the second on.
#[derive(Clone, Copy, Debug)]
pub struct Turns<R, const N: usize> {
    /// From the base's x axis.
    pub space: [(R, R); N],
    /// From the link before.
    pub joint: [(R, R); N],
}

/// Most base parameters that an arm has.
pub const MOST_BASE: usize = 5;

/// Derivatives of one vector by the joint angles and by the joint velocities, rows by columns.
#[derive(Clone, Copy, Debug)]
pub struct Slopes<R, const N: usize> {
    /// By the angles; zero for those that are not [`Arm::FELT`].
    pub angle: [[R; N]; N],
    /// By the velocities.
    pub velocity: [[R; N]; N],
}

/// Where the accelerometers sit.
#[derive(Clone, Copy, Debug)]
pub struct Accelerometers<const N: usize> {
    /// l_a [m], from each link's own axis.
    pub distance: [f64; N],
    /// l_1 [m], from axis to axis.
    pub link_length: f64,
    /// g [m/s^2] in the plane of motion; zero for a horizontal arm.
    pub gravity: f64,
}
