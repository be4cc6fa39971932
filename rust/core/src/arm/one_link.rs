//! A single link on one joint.

use super::link_signals::{LINK_SIGNALS, LinkSignalSlopes, Turns, planar, planar_slopes};
use super::turn::Turn;
use super::{Arm, Name, Slopes};
use crate::parameter::{INERTIA, Parameter, Sign, TORQUE};
use crate::scalar::Real;

/// One link on one joint, revolute or prismatic, with or without gravity in the plane of motion.
#[derive(Clone, Copy, Debug)]
pub struct OneLink<const VERTICAL: bool> {
    /// g [m/s^2] in the plane of motion; not looked at where that is horizontal.
    pub gravity: f64,
    /// l_a [m], the accelerometer's distance from the axis.
    pub accelerometer_distance: f64,
}

/// m_L [kg m^2, or kg] and G1 [N m].
#[derive(Clone, Copy, Debug)]
pub struct OneLinkBase<R> {
    inertia: R,
    g1: R,
}

impl<const VERTICAL: bool> Arm<1> for OneLink<VERTICAL> {
    type Base<R: Real> = OneLinkBase<R>;
    type Posture<R: Real> = Turn<R>;

    type Regressor<R: Real> = [[R; 1]; 2];

    const FELT: [bool; 1] = [VERTICAL];
    const PLANAR: bool = true;

    const PARAMETERS: &'static [Parameter] = &[
        Parameter::new(
            "link_inertia",
            "m_L",
            "inertia that the gear moves with the arm stretched, at the link",
            INERTIA,
            Sign::Positive,
        ),
        Parameter::new(
            "gravity_torque_1",
            "G1",
            "largest gravity torque of link 1, link 2's mass at axis 2",
            TORQUE,
            Sign::Any,
        ),
    ];

    fn names(&self) -> Vec<Name> {
        let of_joint = [Some(1), None];
        let own = Self::PARAMETERS.iter().zip(of_joint);
        own.map(|(parameter, joint)| (parameter.name, joint))
            .collect()
    }

    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; 1],
    ) -> Result<(), (usize, &'static str)> {
        // A rigid gear's link may have its inertia counted with the motor's.
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
            g1: values[1],
        }
    }

    #[inline(always)]
    fn map_base<R: Real, L: Real>(base: &OneLinkBase<R>, to: impl Fn(R) -> L) -> OneLinkBase<L> {
        OneLinkBase {
            inertia: to(base.inertia),
            g1: to(base.g1),
        }
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; 1]) -> Turn<R> {
        if VERTICAL {
            return Turn::of(q[0]);
        }
        Turn {
            sin: R::splat(0.0),
            cos: R::splat(1.0),
        }
    }

    #[inline(always)]
    fn near<R: Real>(&self, from: &Turn<R>, increment: &[R; 1]) -> Turn<R> {
        if VERTICAL {
            from.further(increment[0])
        } else {
            *from
        }
    }

    #[inline(always)]
    fn map_posture<R: Real, L: Real>(at: &Turn<R>, to: impl Fn(R) -> L) -> Turn<L> {
        at.map(&to)
    }

    #[inline(always)]
    fn inertia<R: Real>(&self, base: &OneLinkBase<R>, _: &Turn<R>) -> [[R; 1]; 1] {
        [[base.inertia]]
    }

    #[inline(always)]
    fn bias<R: Real>(&self, base: &OneLinkBase<R>, at: &Turn<R>, _: &[R; 1]) -> [R; 1] {
        [if VERTICAL {
            base.g1 * at.cos
        } else {
            R::splat(0.0)
        }]
    }

    #[inline(always)]
    fn slopes<R: Real>(
        &self,
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
    fn regressor<R: Real>(&self, at: &Turn<R>, _: &[R; 1], ddq: &[R; 1]) -> [[R; 1]; 2] {
        let gravity = if VERTICAL { at.cos } else { R::splat(0.0) };
        [[ddq[0]], [gravity]]
    }

    #[inline(always)]
    fn potential<R: Real>(&self, base: &OneLinkBase<R>, at: &Turn<R>) -> R {
        if VERTICAL {
            base.g1 * at.sin
        } else {
            R::splat(0.0)
        }
    }

    #[inline(always)]
    fn accelerometers<R: Real>(&self, at: &Turn<R>, _: &[R; 1], ddq: &[R; 1]) -> [R; 1] {
        let reading = R::splat(self.accelerometer_distance) * ddq[0];
        [if VERTICAL {
            R::splat(self.gravity).mul_add(at.cos, reading)
        } else {
            reading
        }]
    }

    #[inline(always)]
    fn accelerometer_slopes<R: Real>(
        &self,
        at: &Turn<R>,
        _: &[R; 1],
        _: &[R; 1],
    ) -> (Slopes<R, 1>, [[R; 1]; 1]) {
        let zero = R::splat(0.0);
        let slopes = Slopes {
            angle: [[if VERTICAL {
                -(R::splat(self.gravity) * at.sin)
            } else {
                zero
            }]],
            velocity: [[zero]],
        };
        (slopes, [[R::splat(self.accelerometer_distance)]])
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(&self, _: &Turn<R>, dq: &[R; 1]) -> [R; 1] {
        *dq
    }

    #[inline(always)]
    fn link_signals<R: Real>(
        &self,
        at: &Turn<R>,
        dq: &[R; 1],
        ddq: &[R; 1],
    ) -> [[R; 1]; LINK_SIGNALS] {
        planar(&turns(at), self.felt(), 0.0, dq, ddq)
    }

    #[inline(always)]
    fn link_signal_slopes<R: Real>(
        &self,
        at: &Turn<R>,
        dq: &[R; 1],
        ddq: &[R; 1],
    ) -> [LinkSignalSlopes<R, 1>; 1] {
        planar_slopes(&turns(at), self.felt(), 0.0, dq, ddq)
    }
}

impl<const VERTICAL: bool> OneLink<VERTICAL> {
    /// Gravity in the plane of motion; none where the arm lies flat.
    #[inline(always)]
    fn felt(&self) -> f64 {
        if VERTICAL { self.gravity } else { 0.0 }
    }
}

/// How the link is turned.
#[inline(always)]
fn turns<R: Real>(at: &Turn<R>) -> Turns<R, 1> {
    let own = [(at.sin, at.cos)];
    Turns {
        space: own,
        joint: own,
    }
}
