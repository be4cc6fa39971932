//! The links' equations of motion, one implementation per arm.
//!
//! An arm is what stands on the link side of (2): inertia matrix, velocity torques, gravity. To add
//! another, implement [`Arm`] for it here; the integrator, the gears, the friction and the tests'
//! harness take it as it is.

use crate::real::Real;

/// An arm of `N` links with revolute joints, or a single prismatic one.
pub trait Arm<const N: usize>: Copy + Send + Sync + 'static {
    /// Inertial and gravity parameters, in the order of [`Arm::NAMES`].
    type Base<R: Real>: Copy + Send + Sync;
    /// What the equations need of the joint angles: sines and cosines.
    type Posture<R: Real>: Copy;

    /// Names of the base parameters, as docs/notation.md has them; the joint, from 1, where one
    /// belongs to a joint.
    const NAMES: &'static [(&'static str, Option<usize>)];

    /// Base parameters from a flat list in the order of [`Arm::NAMES`].
    fn base<R: Real>(values: &[R]) -> Self::Base<R>;
    /// Sines and cosines of a posture.
    fn posture<R: Real>(&self, q: &[R; N]) -> Self::Posture<R>;
    /// Inertia matrix M_L(q) [kg m^2], symmetric and positive definite.
    fn inertia<R: Real>(base: &Self::Base<R>, at: &Self::Posture<R>) -> [[R; N]; N];
    /// Centrifugal, Coriolis and gravity torques c(q, dq) + g(q) [N m].
    fn bias<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>, dq: &[R; N]) -> [R; N];
    /// Potential energy of gravity [J], zero at zero angles' height.
    fn potential<R: Real>(&self, base: &Self::Base<R>, at: &Self::Posture<R>) -> R;
    /// Tangential reading [m/s^2] of an accelerometer on each link, (8) and (9) in general form,
    /// gravity's part included: sensors read specific force.
    fn accelerometers<R: Real>(
        &self,
        sensors: &Accelerometers<N>,
        at: &Self::Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N];
    /// Rate of each link in space [rad/s], as a gyro on it reads.
    fn absolute_rates<R: Real>(dq: &[R; N]) -> [R; N];
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

/// A planar arm of two links whose second angle is relative to the first, (3) and (4).
#[derive(Clone, Copy, Debug)]
pub struct TwoLink {
    /// Whether gravity acts in the plane of motion.
    pub vertical: bool,
}

/// alpha, beta, gamma [kg m^2] and the gravity torques G1, G2 [N m].
#[derive(Clone, Copy, Debug)]
pub struct TwoLinkBase<R> {
    alpha: R,
    beta: R,
    gamma: R,
    g1: R,
    g2: R,
}

/// Sines and cosines of two links' angles; those of gravity only where it acts.
#[derive(Clone, Copy, Debug)]
pub struct TwoLinkPosture<R> {
    sin2: R,
    cos2: R,
    first: Option<(R, R)>,  // of q1
    second: Option<(R, R)>, // of q1 + q2
}

impl Arm<2> for TwoLink {
    type Base<R: Real> = TwoLinkBase<R>;
    type Posture<R: Real> = TwoLinkPosture<R>;

    const NAMES: &'static [(&'static str, Option<usize>)] = &[
        ("alpha", None),
        ("beta", None),
        ("gamma", None),
        ("gravity_torque_1", None),
        ("gravity_torque_2", None),
    ];

    #[inline(always)]
    fn base<R: Real>(values: &[R]) -> TwoLinkBase<R> {
        TwoLinkBase {
            alpha: values[0],
            beta: values[1],
            gamma: values[2],
            g1: values[3],
            g2: values[4],
        }
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; 2]) -> TwoLinkPosture<R> {
        let (sin2, cos2) = q[1].sin_cos();
        if !self.vertical {
            return TwoLinkPosture {
                sin2,
                cos2,
                first: None,
                second: None,
            };
        }
        let (sin1, cos1) = q[0].sin_cos();
        let sin12 = sin1.mul_add(cos2, cos1 * sin2);
        let cos12 = cos1.mul_add(cos2, -(sin1 * sin2));
        TwoLinkPosture {
            sin2,
            cos2,
            first: Some((sin1, cos1)),
            second: Some((sin12, cos12)),
        }
    }

    #[inline(always)]
    fn inertia<R: Real>(base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> [[R; 2]; 2] {
        let swing = base.gamma * at.cos2;
        let coupling = base.beta + swing;
        [
            [base.alpha + (coupling + swing), coupling],
            [coupling, base.beta],
        ]
    }

    #[inline(always)]
    fn bias<R: Real>(
        &self,
        base: &TwoLinkBase<R>,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
    ) -> [R; 2] {
        let swing = base.gamma * at.sin2;
        let mut first = -(swing * dq[1]) * (dq[0] + dq[0] + dq[1]);
        let mut second = swing * dq[0] * dq[0];
        if let (Some((_, cos1)), Some((_, cos12))) = (at.first, at.second) {
            let outer = base.g2 * cos12;
            first = base.g1.mul_add(cos1, first + outer);
            second = second + outer;
        }
        [first, second]
    }

    #[inline(always)]
    fn potential<R: Real>(&self, base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> R {
        match (at.first, at.second) {
            (Some((sin1, _)), Some((sin12, _))) => base.g1 * sin1 + base.g2 * sin12,
            _ => R::splat(0.0),
        }
    }

    #[inline(always)]
    fn accelerometers<R: Real>(
        &self,
        sensors: &Accelerometers<2>,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> [R; 2] {
        let elbow = ddq[0].mul_add(at.cos2, dq[0] * dq[0] * at.sin2); // of axis 2, across link 2
        let mut first = R::splat(sensors.distance[0]) * ddq[0];
        let mut second = R::splat(sensors.distance[1]) * (ddq[0] + ddq[1])
            + R::splat(sensors.link_length) * elbow;
        if let (Some((_, cos1)), Some((_, cos12))) = (at.first, at.second) {
            let g = R::splat(sensors.gravity);
            first = g.mul_add(cos1, first);
            second = g.mul_add(cos12, second);
        }
        [first, second]
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(dq: &[R; 2]) -> [R; 2] {
        [dq[0], dq[0] + dq[1]]
    }
}

/// One link on one joint, revolute or prismatic.
#[derive(Clone, Copy, Debug)]
pub struct OneLink {
    /// Whether gravity acts in the plane of motion.
    pub vertical: bool,
}

/// m_L [kg m^2, or kg] and G1 [N m].
#[derive(Clone, Copy, Debug)]
pub struct OneLinkBase<R> {
    inertia: R,
    g1: R,
}

impl Arm<1> for OneLink {
    type Base<R: Real> = OneLinkBase<R>;
    type Posture<R: Real> = Option<(R, R)>;

    const NAMES: &'static [(&'static str, Option<usize>)] =
        &[("link_inertia", Some(1)), ("gravity_torque_1", None)];

    #[inline(always)]
    fn base<R: Real>(values: &[R]) -> OneLinkBase<R> {
        OneLinkBase {
            inertia: values[0],
            g1: values[1],
        }
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; 1]) -> Option<(R, R)> {
        self.vertical.then(|| q[0].sin_cos())
    }

    #[inline(always)]
    fn inertia<R: Real>(base: &OneLinkBase<R>, _: &Option<(R, R)>) -> [[R; 1]; 1] {
        [[base.inertia]]
    }

    #[inline(always)]
    fn bias<R: Real>(&self, base: &OneLinkBase<R>, at: &Option<(R, R)>, _: &[R; 1]) -> [R; 1] {
        [at.map_or(R::splat(0.0), |(_, cos1)| base.g1 * cos1)]
    }

    #[inline(always)]
    fn potential<R: Real>(&self, base: &OneLinkBase<R>, at: &Option<(R, R)>) -> R {
        at.map_or(R::splat(0.0), |(sin1, _)| base.g1 * sin1)
    }

    #[inline(always)]
    fn accelerometers<R: Real>(
        &self,
        sensors: &Accelerometers<1>,
        at: &Option<(R, R)>,
        _: &[R; 1],
        ddq: &[R; 1],
    ) -> [R; 1] {
        let reading = R::splat(sensors.distance[0]) * ddq[0];
        [at.map_or(reading, |(_, cos1)| {
            R::splat(sensors.gravity).mul_add(cos1, reading)
        })]
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(dq: &[R; 1]) -> [R; 1] {
        *dq
    }
}
