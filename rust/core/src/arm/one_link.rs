//! A single link on one joint.

use super::link_signals::{LINK_SIGNALS, LinkRotations, planar};
use super::sine_cosine::SineCosine;
use super::{Arm, ChainJoint, JointType, Name, SerialChain, Slopes, has_gravity};
use crate::parameter::{INERTIA, Parameter, TORQUE};
use crate::scalar::Real;

/// One link on one joint, revolute or prismatic.
#[derive(Clone, Copy, Debug)]
pub struct OneLink {
    /// Kind of motion.
    pub joint_type: JointType,
    /// g [m/s^2] in the plane of motion. At zero the gravity torque has no effect.
    pub gravity: f64,
    /// l_a [m], distance of the accelerometer from the axis.
    pub accelerometer_distance: f64,
}

/// m_L [kg m^2, or kg] and G1 [N m].
#[derive(Clone, Copy, Debug)]
pub struct OneLinkBase<R> {
    inertia: R,
    g1: R,
}

impl Arm<1> for OneLink {
    type Base<R: Real> = OneLinkBase<R>;
    type Posture<R: Real> = SineCosine<R>;

    type Regressor<R: Real> = [[R; 1]; 2];

    const DEPENDS_ON_ANGLE: [bool; 1] = [true];
    const PLANAR: bool = true;

    const PARAMETERS: &'static [Parameter] = &[
        Parameter::positive("link_inertia", "m_L", INERTIA)
            .meaning("inertia that the gear moves with the arm stretched, at the link"),
        Parameter::any("gravity_torque_1", "G1", TORQUE)
            .meaning("largest gravity torque of link 1, link 2's mass at axis 2"),
    ];

    fn names(&self) -> Vec<Name> {
        let of_joint = [Some(1), None];
        let named = Self::PARAMETERS.iter().zip(of_joint);
        named
            .map(|(parameter, joint)| (parameter.name, joint))
            .collect()
    }

    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; 1],
    ) -> Result<(), (usize, &'static str)> {
        // behind a rigid gear, the link's inertia may be included in the motor's
        match reflected {
            [Some(_)] if values[0] < 0.0 => Err((0, "zero or positive")),
            [None] if values[0] <= 0.0 => Err((0, "positive")),
            _ => Ok(()),
        }
    }

    #[inline(always)]
    fn base<R: Real>(&self, values: &[R]) -> OneLinkBase<R> {
        OneLinkBase {
            inertia: values[0],
            g1: match self.gravity {
                0.0 => R::splat(0.0),
                _ => values[1],
            },
        }
    }

    #[inline(always)]
    fn map_base<R: Real, L: Real>(base: &OneLinkBase<R>, to: impl Fn(R) -> L) -> OneLinkBase<L> {
        OneLinkBase {
            inertia: to(base.inertia),
            g1: to(base.g1),
        }
    }

    fn chain(&self) -> SerialChain<1> {
        let joint = ChainJoint::planar(self.joint_type, 0.0);
        SerialChain::planar(&[joint], self.gravity)
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; 1]) -> SineCosine<R> {
        SineCosine::of(q[0])
    }

    #[inline(always)]
    fn near<R: Real>(&self, from: &SineCosine<R>, increment: &[R; 1]) -> SineCosine<R> {
        from.plus_small_angle(increment[0])
    }

    #[inline(always)]
    fn map_posture<R: Real, L: Real>(at: &SineCosine<R>, to: impl Fn(R) -> L) -> SineCosine<L> {
        at.map(&to)
    }

    #[inline(always)]
    fn inertia<R: Real>(&self, base: &OneLinkBase<R>, _: &SineCosine<R>) -> [[R; 1]; 1] {
        [[base.inertia]]
    }

    #[inline(always)]
    fn bias<R: Real>(&self, base: &OneLinkBase<R>, at: &SineCosine<R>, _: &[R; 1]) -> [R; 1] {
        [base.g1 * at.cos]
    }

    #[inline(always)]
    fn slopes<R: Real>(
        &self,
        base: &OneLinkBase<R>,
        at: &SineCosine<R>,
        _: &[R; 1],
        _: &[R; 1],
    ) -> Slopes<R, 1> {
        Slopes {
            angle: [[-(base.g1 * at.sin)]],
            velocity: [[R::splat(0.0)]],
        }
    }

    #[inline(always)]
    fn regressor<R: Real>(&self, at: &SineCosine<R>, _: &[R; 1], ddq: &[R; 1]) -> [[R; 1]; 2] {
        [[ddq[0]], [at.cos * has_gravity(self.gravity)]]
    }

    #[inline(always)]
    fn zero_regressor<R: Real>(&self) -> [[R; 1]; 2] {
        [[R::splat(0.0)]; 2]
    }

    #[inline(always)]
    fn potential<R: Real>(&self, base: &OneLinkBase<R>, at: &SineCosine<R>) -> R {
        base.g1 * at.sin
    }

    #[inline(always)]
    fn accelerometers<R: Real>(&self, at: &SineCosine<R>, _: &[R; 1], ddq: &[R; 1]) -> [R; 1] {
        let reading = ddq[0] * self.accelerometer_distance;
        [R::splat(self.gravity).mul_add(at.cos, reading)]
    }

    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        &self,
        at: &SineCosine<R>,
        _: &[R; 1],
        _: &[R; 1],
    ) -> (Slopes<R, 1>, [[R; 1]; 1]) {
        let slopes = Slopes {
            angle: [[-(at.sin * self.gravity)]],
            velocity: [[R::splat(0.0)]],
        };
        (slopes, [[R::splat(self.accelerometer_distance)]])
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(&self, _: &SineCosine<R>, dq: &[R; 1]) -> [R; 1] {
        *dq
    }

    #[inline(always)]
    fn link_signals<R: Real>(
        &self,
        at: &SineCosine<R>,
        dq: &[R; 1],
        ddq: &[R; 1],
    ) -> [[R; 1]; LINK_SIGNALS] {
        planar(&link_rotations(at), self.gravity, 0.0, dq, ddq)
    }
}

/// Rotation of the link.
#[inline(always)]
fn link_rotations<R: Real>(at: &SineCosine<R>) -> LinkRotations<R, 1> {
    let rotation = [(at.sin, at.cos)];
    LinkRotations {
        space: rotation,
        joint: rotation,
    }
}
