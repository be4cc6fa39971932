//! The planar arm of two links, (3) and (4).

use super::turn::Turn;
use crate::arm::{Accelerometers, Arm, MOST_BASE, Slopes, Turns};
use crate::scalar::Real;

/// A planar arm of two links whose second angle is relative to the first, (3) and (4), with or
/// without gravity in the plane of motion.
#[derive(Clone, Copy, Debug)]
pub struct TwoLink<const VERTICAL: bool>;

/// alpha, beta, gamma [kg m^2] and the gravity torques G1, G2 [N m].
#[derive(Clone, Copy, Debug)]
pub struct TwoLinkBase<R> {
    alpha: R,
    beta: R,
    gamma: R,
    g1: R,
    g2: R,
}

/// The turns of q1 and q2; a horizontal arm does not need the first.
#[derive(Clone, Copy, Debug)]
pub struct TwoLinkPosture<R> {
    first: Turn<R>,
    second: Turn<R>,
}

impl<const VERTICAL: bool> Arm<2> for TwoLink<VERTICAL> {
    type Base<R: Real> = TwoLinkBase<R>;
    type Posture<R: Real> = TwoLinkPosture<R>;

    const NAMES: &'static [(&'static str, Option<usize>)] = &[
        ("alpha", None),
        ("beta", None),
        ("gamma", None),
        ("gravity_torque_1", None),
        ("gravity_torque_2", None),
    ];
    const FELT: [bool; 2] = [VERTICAL, true];

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
    fn posture<R: Real>(q: &[R; 2]) -> TwoLinkPosture<R> {
        let second = Turn::of(q[1]);
        let first = if VERTICAL { Turn::of(q[0]) } else { second };
        TwoLinkPosture { first, second }
    }

    #[inline(always)]
    fn near<R: Real>(from: &TwoLinkPosture<R>, increment: &[R; 2]) -> TwoLinkPosture<R> {
        let second = from.second.further(increment[1]);
        let first = if VERTICAL {
            from.first.further(increment[0])
        } else {
            second
        };
        TwoLinkPosture { first, second }
    }

    #[inline(always)]
    fn spread<R: Real, L: Real>(at: &TwoLinkPosture<R>) -> TwoLinkPosture<L> {
        TwoLinkPosture {
            first: at.first.spread(),
            second: at.second.spread(),
        }
    }

    #[inline(always)]
    fn inertia<R: Real>(base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> [[R; 2]; 2] {
        let swing = base.gamma * at.second.cos;
        let coupling = base.beta + swing;
        [
            [base.alpha + (coupling + swing), coupling],
            [coupling, base.beta],
        ]
    }

    #[inline(always)]
    fn bias<R: Real>(base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>, dq: &[R; 2]) -> [R; 2] {
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
    fn regressor<R: Real>(
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> [[R; 2]; MOST_BASE] {
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
            inner = at.first.cos;
            outer = at.first.plus(at.second).cos;
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
    fn potential<R: Real>(base: &TwoLinkBase<R>, at: &TwoLinkPosture<R>) -> R {
        if VERTICAL {
            base.g1 * at.first.sin + base.g2 * at.first.plus(at.second).sin
        } else {
            R::splat(0.0)
        }
    }

    #[inline(always)]
    fn accelerometers<R: Real>(
        sensors: &Accelerometers<2>,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> [R; 2] {
        // Acceleration of axis 2 across link 2, per metre of link 1.
        let elbow = ddq[0].mul_add(at.second.cos, dq[0] * dq[0] * at.second.sin);
        let mut first = R::splat(sensors.distance[0]) * ddq[0];
        let mut second = R::splat(sensors.distance[1]) * (ddq[0] + ddq[1])
            + R::splat(sensors.link_length) * elbow;
        if VERTICAL {
            let g = R::splat(sensors.gravity);
            first = g.mul_add(at.first.cos, first);
            second = g.mul_add(at.first.plus(at.second).cos, second);
        }
        [first, second]
    }

    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        sensors: &Accelerometers<2>,
        at: &TwoLinkPosture<R>,
        dq: &[R; 2],
        ddq: &[R; 2],
    ) -> (Slopes<R, 2>, [[R; 2]; 2]) {
        let zero = R::splat(0.0);
        let length = R::splat(sensors.link_length);
        let (sin, cos) = (length * at.second.sin, length * at.second.cos);
        let elbow = cos.mul_add(dq[0] * dq[0], -(sin * ddq[0]));
        let mut angle = [[zero, zero], [zero, elbow]];
        if VERTICAL {
            let g = -R::splat(sensors.gravity);
            let outer = g * at.first.plus(at.second).sin;
            angle = [[g * at.first.sin, zero], [outer, elbow + outer]];
        }
        let velocity = [[zero, zero], [(sin + sin) * dq[0], zero]];
        let [first, second] = sensors.distance.map(R::splat);
        let acceleration = [[first, zero], [second + cos, second]];
        (Slopes { angle, velocity }, acceleration)
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(dq: &[R; 2]) -> [R; 2] {
        [dq[0], dq[0] + dq[1]]
    }

    #[inline(always)]
    fn turns<R: Real>(at: &TwoLinkPosture<R>) -> Turns<R, 2> {
        let both = at.first.plus(at.second);
        Turns {
            space: [(at.first.sin, at.first.cos), (both.sin, both.cos)],
            joint: [(at.first.sin, at.first.cos), (at.second.sin, at.second.cos)],
        }
    }
}
