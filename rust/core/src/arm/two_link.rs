//! The planar arm of two links, (3) and (4).

use super::link_signals::{LINK_SIGNALS, LinkRotations, planar};
use super::sine_cosine::SineCosine;
use super::{Arm, ChainJoint, JointType, Name, SerialChain, Slopes, has_gravity};
use crate::parameter::{INERTIA, Parameter, TORQUE};
use crate::scalar::Real;

/// A planar arm of two links whose second angle is relative to the first, (3) and (4).
///
/// A horizontal arm is a vertical one without gravity. `TwoLink<false>` is the same arm without the
/// terms of gravity, which are a fifth of a step.
#[derive(Clone, Copy, Debug)]
pub struct TwoLink<const VERTICAL: bool> {
    /// l_1 [m], from axis to axis.
    pub link_length: f64,
    /// g [m/s^2] in the plane of motion. At zero the gravity torques have no effect.
    pub gravity: f64,
    /// l_a [m], distance of the accelerometers from the axes of their links.
    pub accelerometer_distance: [f64; 2],
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

/// Rotations by q1 and q2; a horizontal arm does not need the first.
#[derive(Clone, Copy, Debug)]
pub struct TwoLinkPosture<R> {
    first: SineCosine<R>,
    second: SineCosine<R>,
}

impl<const VERTICAL: bool> Arm<2> for TwoLink<VERTICAL> {
    type Base<R: Real> = TwoLinkBase<R>;
    type Posture<R: Real> = TwoLinkPosture<R>;

    type Regressor<R: Real> = [[R; 2]; 5];

    const DEPENDS_ON_ANGLE: [bool; 2] = [VERTICAL, true];
    const PLANAR: bool = true;

    const PARAMETERS: &'static [Parameter] = &[
        Parameter::positive("alpha", "alpha", INERTIA)
            .meaning("inertia of link 1 and of link 2's mass at axis 2, about axis 1"),
        Parameter::positive("beta", "beta", INERTIA).meaning("inertia of link 2 about axis 2"),
        Parameter::any("gamma", "gamma", INERTIA)
            .meaning("coupling of the links: link length times first moment of link 2"),
        Parameter::any("gravity_torque_1", "G1", TORQUE)
            .meaning("largest gravity torque of link 1, link 2's mass at axis 2"),
        Parameter::any("gravity_torque_2", "G2", TORQUE)
            .meaning("largest gravity torque of link 2"),
    ];

    fn names(&self) -> Vec<Name> {
        let parameters = Self::PARAMETERS.iter();
        parameters.map(|parameter| (parameter.name, None)).collect()
    }

    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; 2],
    ) -> Result<(), (usize, &'static str)> {
        let [alpha, beta, gamma] = [values[0], values[1], values[2]];
        if let Some(index) = [alpha, beta].iter().position(|&value| value <= 0.0) {
            return Err((index, "positive"));
        }
        // det = (alpha + m1)(beta + m2) + (beta + 2 gamma c) m2 - gamma^2 c^2 is concave in c = cos
        // q2, so its minimum is at c = 1 or c = -1
        let [m1, m2] = reflected.map(|inertia| inertia.unwrap_or(0.0));
        let least = [1.0, -1.0]
            .map(|c| (alpha + m1) * (beta + m2) + (beta + 2.0 * gamma * c) * m2 - gamma * gamma)
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        if least <= 0.0 {
            return Err((2, "smaller than the square root of alpha times beta"));
        }
        Ok(())
    }

    #[inline(always)]
    fn base<R: Real>(&self, values: &[R]) -> TwoLinkBase<R> {
        let torque = |value: R| match self.gravity {
            0.0 => R::splat(0.0),
            _ => value,
        };
        TwoLinkBase {
            alpha: values[0],
            beta: values[1],
            gamma: values[2],
            g1: torque(values[3]),
            g2: torque(values[4]),
        }
    }

    #[inline(always)]
    fn map_base<R: Real, L: Real>(base: &TwoLinkBase<R>, to: impl Fn(R) -> L) -> TwoLinkBase<L> {
        TwoLinkBase {
            alpha: to(base.alpha),
            beta: to(base.beta),
            gamma: to(base.gamma),
            g1: to(base.g1),
            g2: to(base.g2),
        }
    }

    fn chain(&self) -> SerialChain<2> {
        let length = self.link_length;
        let joints = [0.0, length].map(|x| ChainJoint::planar(JointType::Revolute, x));
        SerialChain::planar(&joints, self.gravity)
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; 2]) -> TwoLinkPosture<R> {
        let second = SineCosine::of(q[1]);
        let first = if VERTICAL {
            SineCosine::of(q[0])
        } else {
            second
        };
        TwoLinkPosture { first, second }
    }

    #[inline(always)]
    fn near<R: Real>(&self, from: &TwoLinkPosture<R>, increment: &[R; 2]) -> TwoLinkPosture<R> {
        let second = from.second.plus_small_angle(increment[1]);
        let first = if VERTICAL {
            from.first.plus_small_angle(increment[0])
        } else {
            second
        };
        TwoLinkPosture { first, second }
    }

    #[inline(always)]
    fn map_posture<R: Real, L: Real>(
        at: &TwoLinkPosture<R>,
        to: impl Fn(R) -> L,
    ) -> TwoLinkPosture<L> {
        TwoLinkPosture {
            first: at.first.map(&to),
            second: at.second.map(&to),
        }
    }

    #[inline(always)]
    fn inertia<R: Real>(&self, base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> [[R; 2]; 2] {
        let swing = base.gamma * at.second.cos;
        let coupling = base.beta + swing;
        [
            [base.alpha + (coupling + swing), coupling],
            [coupling, base.beta],
        ]
    }

    #[inline(always)]
    fn bias<R: Real>(&self, base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>, dq: &[R; 2]) -> [R; 2] {
        let swing = base.gamma * at.second.sin;
        let mut first = -(swing * dq[1]) * (dq[0] + dq[0] + dq[1]);
        let mut second = swing * dq[0] * dq[0];
        if VERTICAL {
            let outer = base.g2 * at.first.plus(at.second).cos;
            first = base.g1.mul_add(at.first.cos, first + outer);
            second = second + outer;
        }
        [first, second]
    }

    #[inline(always)]
    fn slopes<R: Real>(
        &self,
        base: &TwoLinkBase<R>,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> Slopes<R, 2> {
        let zero = R::splat(0.0);
        let (sin, cos) = (base.gamma * at.second.sin, base.gamma * at.second.cos);
        let sum = dq[0] + dq[1];
        let (whirl, turn) = (dq[1] * (dq[0] + sum), ddq[0] + ddq[0] + ddq[1]);
        let mut angle = [
            [zero, -sin.mul_add(turn, cos * whirl)],
            [zero, cos.mul_add(dq[0] * dq[0], -(sin * ddq[0]))],
        ];
        if VERTICAL {
            let outer = -(base.g2 * at.first.plus(at.second).sin);
            let inner = -(base.g1 * at.first.sin);
            angle = [
                [inner + outer, angle[0][1] + outer],
                [outer, angle[1][1] + outer],
            ];
        }
        let twice = sin + sin;
        let velocity = [[-(twice * dq[1]), -(twice * sum)], [twice * dq[0], zero]];
        Slopes { angle, velocity }
    }

    #[inline(always)]
    fn regressor<R: Real>(&self, at: &TwoLinkPosture<R>, dq: &[R; 2], ddq: &[R; 2]) -> [[R; 2]; 5] {
        let zero = R::splat(0.0);
        let (sin, cos) = (at.second.sin, at.second.cos);
        let both = ddq[0] + ddq[1];
        let whirl = dq[1] * (dq[0] + dq[0] + dq[1]);
        let gamma = [
            cos.mul_add(ddq[0] + both, -(sin * whirl)),
            cos.mul_add(ddq[0], sin * dq[0] * dq[0]),
        ];
        let (mut inner, mut outer) = (zero, zero);
        if VERTICAL {
            let plane_gravity = R::splat(has_gravity(self.gravity));
            inner = plane_gravity * at.first.cos;
            outer = plane_gravity * at.first.plus(at.second).cos;
        }
        [
            [ddq[0], zero],
            [both, both],
            gamma,
            [inner, zero],
            [outer, outer],
        ]
    }

    #[inline(always)]
    fn zero_regressor<R: Real>(&self) -> [[R; 2]; 5] {
        [[R::splat(0.0); 2]; 5]
    }

    #[inline(always)]
    fn potential<R: Real>(&self, base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> R {
        if VERTICAL {
            base.g1 * at.first.sin + base.g2 * at.first.plus(at.second).sin
        } else {
            R::splat(0.0)
        }
    }

    #[inline(always)]
    fn accelerometers<R: Real>(&self, at: &TwoLinkPosture<R>, dq: &[R; 2], ddq: &[R; 2]) -> [R; 2] {
        // acceleration of axis 2 across link 2, per metre of link 1
        let elbow = ddq[0].mul_add(at.second.cos, dq[0] * dq[0] * at.second.sin);
        let mut first = ddq[0] * self.accelerometer_distance[0];
        let mut second =
            (ddq[0] + ddq[1]) * self.accelerometer_distance[1] + elbow * self.link_length;
        if VERTICAL {
            let g = R::splat(self.gravity);
            first = g.mul_add(at.first.cos, first);
            second = g.mul_add(at.first.plus(at.second).cos, second);
        }
        [first, second]
    }

    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        &self,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> (Slopes<R, 2>, [[R; 2]; 2]) {
        let zero = R::splat(0.0);
        let length = R::splat(self.link_length);
        let (sin, cos) = (length * at.second.sin, length * at.second.cos);
        let elbow = cos.mul_add(dq[0] * dq[0], -(sin * ddq[0]));
        let mut angle = [[zero, zero], [zero, elbow]];
        if VERTICAL {
            let g = -R::splat(self.gravity);
            let outer = g * at.first.plus(at.second).sin;
            angle = [[g * at.first.sin, zero], [outer, elbow + outer]];
        }
        let velocity = [[zero, zero], [(sin + sin) * dq[0], zero]];
        let [first, second] = self.accelerometer_distance.map(R::splat);
        let acceleration = [[first, zero], [second + cos, second]];
        (Slopes { angle, velocity }, acceleration)
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(&self, _: &TwoLinkPosture<R>, dq: &[R; 2]) -> [R; 2] {
        [dq[0], dq[0] + dq[1]]
    }

    #[inline(always)]
    fn link_signals<R: Real>(
        &self,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> [[R; 2]; LINK_SIGNALS] {
        planar(
            &self.link_rotations(at),
            self.plane_gravity(),
            self.link_length,
            dq,
            ddq,
        )
    }
}

impl TwoLink<true> {
    /// The same arm without the terms of gravity, for horizontal arms.
    pub fn level(&self) -> TwoLink<false> {
        TwoLink {
            link_length: self.link_length,
            gravity: 0.0,
            accelerometer_distance: self.accelerometer_distance,
        }
    }
}

impl<const VERTICAL: bool> TwoLink<VERTICAL> {
    /// Gravity in the plane of motion.
    #[inline(always)]
    fn plane_gravity(&self) -> f64 {
        if VERTICAL { self.gravity } else { 0.0 }
    }

    /// Rotations of the links.
    #[inline(always)]
    fn link_rotations<R: Real>(&self, at: &TwoLinkPosture<R>) -> LinkRotations<R, 2> {
        let both = at.first.plus(at.second);
        LinkRotations {
            space: [(at.first.sin, at.first.cos), (both.sin, both.cos)],
            joint: [(at.first.sin, at.first.cos), (at.second.sin, at.second.cos)],
        }
    }
}
