//! Equations of motion of the links, one implementation per arm.
//!
//! An arm implements the link side of (2): inertia matrix, velocity torques, gravity, and the
//! readings of sensors on its links. To add an arm, implement [`Arm`] for it in a file here;
//! integrator, gears, friction, servo and sensitivities work with every implementation. Derivatives
//! with respect to the motion follow from the equations over [`crate::scalar::Jet`]s, unless the
//! arm has a closed form, which is faster.

mod differentiation;
pub mod link_signals;
mod one_link;
mod serial_chain;
mod sine_cosine;
pub(crate) mod transmission;
mod two_link;

pub use one_link::OneLink;
pub use serial_chain::{ChainJoint, JointType, Kinematics, MAX_CHAIN_JOINTS, SerialChain};
pub use transmission::Transmission;
pub use two_link::TwoLink;

use crate::parameter::Parameter;
use crate::scalar::Real;
use link_signals::LINK_SIGNALS;

/// A parameter's name, and its joint, from 1, if it belongs to one.
pub type Name = (&'static str, Option<usize>);

/// Equations that are compiled as separate functions.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Outlined {
    /// None.
    Nothing,
    /// Each stage of a step.
    Stages,
    /// Each stage of a step, and its parts.
    Parts,
}

/// An arm of up to `N` joints. A value holds its geometry.
pub trait Arm<const N: usize>: Copy + Send + Sync + 'static {
    /// Inertial and gravity parameters, in the order of [`Arm::names`].
    type Base<R: Real>: Copy + Send + Sync;
    /// Functions of the joint angles that the equations share: sines and cosines.
    type Posture<R: Real>: Copy;
    /// Torques [N m] of every joint for each of the base parameters.
    type Regressor<R: Real>: AsRef<[[R; N]]>;

    /// Whether the equations depend on each joint's angle. Those of a horizontal arm do not depend
    /// on the first.
    const DEPENDS_ON_ANGLE: [bool; N];
    /// Whether all axes are parallel. The rate of a link in space is then the sum of the joint
    /// rates up to it, and the reading of its accelerometer does not depend on the velocity of its
    /// own joint.
    const PLANAR: bool;
    /// Which equations are compiled as separate functions, which keeps the programs of arms with
    /// long equations small.
    const OUTLINED: Outlined = Outlined::Nothing;

    /// The base parameters, each once; those of one link for a chain.
    const PARAMETERS: &'static [Parameter];

    /// Number of joints, at most `N`. Further entries of arrays belong to no joint: parameters and
    /// motion are zero there.
    #[inline(always)]
    fn joints(&self) -> usize {
        N
    }
    /// Names of the base parameters as in docs/notation.md, with the joint, from 1, if they belong
    /// to one.
    fn names(&self) -> Vec<Name>;
    /// Checks finite values of the base parameters: the inertia matrix must be positive definite at
    /// every posture. `reflected` [kg m^2] is the reflected inertia of motors behind rigid gears.
    ///
    /// # Errors
    /// The index of the first impossible value, and its requirement.
    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; N],
    ) -> Result<(), (usize, &'static str)>;
    /// Base parameters from a flat list in the order of [`Arm::names`].
    fn base<R: Real>(&self, values: &[R]) -> Self::Base<R>;
    /// The base parameters converted by a function.
    fn map_base<R: Real, L: Real>(base: &Self::Base<R>, to: impl Fn(R) -> L) -> Self::Base<L>;

    /// The same joints and gravity as a chain.
    fn chain(&self) -> SerialChain<N>;
    /// Transmission between motors and joints; `None` if each motor moves its own joint only.
    #[inline(always)]
    fn transmission(&self) -> Option<&Transmission<N>> {
        None
    }

    /// Sines and cosines of a posture.
    fn posture<R: Real>(&self, q: &[R; N]) -> Self::Posture<R>;
    /// Sines and cosines at slightly larger angles: exact to rounding for increments below 0.05
    /// rad, the rotation within one step of the integrator.
    fn near<R: Real>(&self, from: &Self::Posture<R>, increment: &[R; N]) -> Self::Posture<R>;
    /// A posture converted by a function.
    fn map_posture<R: Real, L: Real>(
        at: &Self::Posture<R>,
        to: impl Fn(R) -> L,
    ) -> Self::Posture<L>;

    /// Inertia matrix M_L(q) [kg m^2], symmetric and positive definite.
    fn inertia<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>) -> [[R; N]; N];
    /// Centrifugal, Coriolis and gravity torques c(q, dq) + g(q) [N m].
    fn bias<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// [`Arm::inertia`] with correct rows up to the diagonal, and [`Arm::bias`].
    #[inline(always)]
    fn equations<R: Real>(
        &self,
        base: &Self::Base<R>,
        at: &Self::Posture<R>,
        dq: &[R; N],
    ) -> ([[R; N]; N], [R; N]) {
        (self.inertia(base, at), self.bias(base, at, dq))
    }
    /// Derivatives of M_L(q) ddq + c + g with respect to the base parameters, in the order of
    /// [`Arm::names`].
    fn regressor<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> Self::Regressor<R>;
    /// The regressor of an arm without torques.
    fn zero_regressor<R: Real>(&self) -> Self::Regressor<R>;
    /// Updates a regressor in place.
    #[inline(always)]
    fn update_regressor<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
        regressor: &mut Self::Regressor<R>,
    ) {
        *regressor = self.regressor(at, dq, ddq);
    }
    /// Index of the first base parameter on which the torque of a joint may depend.
    #[inline(always)]
    fn first_parameter(&self, _: usize) -> usize {
        0
    }
    /// Potential energy of gravity [J], relative to a fixed height.
    fn potential<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>) -> R;

    /// Tangential reading [m/s^2] of an accelerometer on each link, (8) and (9) in general form.
    /// Sensors read specific force, so gravity is included.
    fn accelerometers<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N], ddq: &[R; N]) -> [R; N];
    /// Rate of each link in space [rad/s] about its own axis, the reading of a gyro on it.
    fn absolute_rates<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// Basis signals of sensors at any place on each link, see [`link_signals`].
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

    /// Derivatives of [`Arm::torques`] with respect to angles and velocities.
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
    /// [`Arm::inertia`] and [`Arm::slopes`].
    #[inline(always)]
    fn linearised_equations<R: Real>(
        &self,
        base: &Self::Base<R>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> ([[R; N]; N], Slopes<R, N>) {
        (self.inertia(base, at), self.slopes(base, at, dq, ddq))
    }
    /// Derivatives of [`Arm::accelerometers`] with respect to angles and velocities, and to
    /// accelerations.
    ///
    /// A sensor depends on the joints up to its own. Other entries are zero and are not used.
    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        &self,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> (Slopes<R, N>, [[R; N]; N]) {
        differentiation::accelerometer_slopes(self, (at, dq, ddq))
    }
    /// Derivatives of [`Arm::absolute_rates`] with respect to angles and velocities.
    #[inline(always)]
    fn rate_slopes<R: Real>(&self, at: &Self::Posture<R>, dq: &[R; N]) -> Slopes<R, N> {
        differentiation::rate_slopes(self, at, dq)
    }
}

/// The entries of the first joints.
pub(crate) fn first_joints<T: Copy, const N: usize, const M: usize>(all: &[T; N]) -> [T; M] {
    *all.first_chunk().expect("at most as many joints")
}

/// One for a plane of motion with gravity, zero for a horizontal one.
#[inline(always)]
fn has_gravity(gravity: f64) -> f64 {
    if gravity == 0.0 { 0.0 } else { 1.0 }
}

/// Derivatives of a vector (rows) with respect to joint angles and joint velocities (columns).
#[derive(Clone, Copy, Debug)]
pub struct Slopes<R, const N: usize> {
    /// With respect to the angles; zero unless [`Arm::DEPENDS_ON_ANGLE`].
    pub angle: [[R; N]; N],
    /// With respect to the velocities.
    pub velocity: [[R; N]; N],
}
