//! A single link on one joint.

use super::turn::Turn;
use crate::arm::{Accelerometers, Arm, MOST_BASE, Slopes, Turns};
use crate::scalar::Real;

/// One link on one joint, revolute or prismatic, with or without gravity in the plane of motion.
#[derive(Clone, Copy, Debug)]
pub struct OneLink<const VERTICAL: bool>;

/// m_L [kg m^2, or kg] and G1 [N m].
#[derive(Clone, Copy, Debug)]
pub struct OneLinkBase<R> {
    inertia: R,
    g1: R,
}

impl<const VERTICAL: bool> Arm<1> for OneLink<VERTICAL> {
    type Base<R: Real> = OneLinkBase<R>;
    type Posture<R: Real> = Turn<R>;

    const NAMES: &'static [(&'static str, Option<usize>)] =
        &[("link_inertia", Some(1)), ("gravity_torque_1", None)];
    const FELT: [bool; 1] = [VERTICAL];

    #[inline(always)]
    fn base<R: Real>(values: &[R]) -> OneLinkBase<R> {
        OneLinkBase {
            inertia: values[0],
            g1: values[1],
        }
    }

    #[inline(always)]
    fn posture<R: Real>(q: &[R; 1]) -> Turn<R> {
        if VERTICAL {
            return Turn::of(q[0]);
        }
        Turn {
            sin: R::splat(0.0),
            cos: R::splat(1.0),
        }
    }

    #[inline(always)]
    fn near<R: Real>(from: &Turn<R>, increment: &[R; 1]) -> Turn<R> {
        if VERTICAL {
            from.further(increment[0])
        } else {
            *from
        }
    }

    #[inline(always)]
    fn spread<R: Real, L: Real>(at: &Turn<R>) -> Turn<L> {
        at.spread()
    }

    #[inline(always)]
    fn inertia<R: Real>(base: &OneLinkBase<R>, _: &Turn<R>) -> [[R; 1]; 1] {
        [[base.inertia]]
    }

    #[inline(always)]
    fn bias<R: Real>(base: &OneLinkBase<R>, at: &Turn<R>, _: &[R; 1]) -> [R; 1] {
        [if VERTICAL {
            base.g1 * at.cos
        } else {
            R::splat(0.0)
        }]
    }

    #[inline(always)]
    fn slopes<R: Real>(
        base: &OneLinkBase<R>,
        at: &Turn<R>,
        _: &[R; 1],
        _: &[R; 1],
    ) -> Slopes<R, 1> {
        let zero = R::splat(0.0);
        Slopes {
            angle: [[if VERTICAL { -(base.g1 * at.sin) } else { zero }]],
            velocity: [[zero]],
        }
    }

    #[inline(always)]
    fn regressor<R: Real>(at: &Turn<R>, _: &[R; 1], ddq: &[R; 1]) -> [[R; 1]; MOST_BASE] {
        let zero = R::splat(0.0);
        let gravity = if VERTICAL { at.cos } else { zero };
        [[ddq[0]], [gravity], [zero], [zero], [zero]]
    }

    #[inline(always)]
    fn potential<R: Real>(base: &OneLinkBase<R>, at: &Turn<R>) -> R {
        if VERTICAL {
            base.g1 * at.sin
        } else {
            R::splat(0.0)
        }
    }

    #[inline(always)]
    fn accelerometers<R: Real>(
        sensors: &Accelerometers<1>,
        at: &Turn<R>,
        _: &[R; 1],
        ddq: &[R; 1],
    ) -> [R; 1] {
        let reading = R::splat(sensors.distance[0]) * ddq[0];
        [if VERTICAL {
            R::splat(sensors.gravity).mul_add(at.cos, reading)
        } else {
            reading
        }]
    }

    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        sensors: &Accelerometers<1>,
        at: &Turn<R>,
        _: &[R; 1],
        _: &[R; 1],
    ) -> (Slopes<R, 1>, [[R; 1]; 1]) {
        let zero = R::splat(0.0);
        let slopes = Slopes {
            angle: [[if VERTICAL {
                -(R::splat(sensors.gravity) * at.sin)
            } else {
                zero
            }]],
            velocity: [[zero]],
        };
        (slopes, [[R::splat(sensors.distance[0])]])
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(dq: &[R; 1]) -> [R; 1] {
        *dq
    }

    #[inline(always)]
    fn turns<R: Real>(at: &Turn<R>) -> Turns<R, 1> {
        let own = [(at.sin, at.cos)];
        Turns {
            space: own,
            joint: own,
        }
    }
}
