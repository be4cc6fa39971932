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

/// Sine and cosine of one angle.
#[derive(Clone, Copy, Debug)]
pub struct Turn<R> {
    sin: R,
    cos: R,
}

impl<R: Real> Turn<R> {
    #[inline(always)]
    fn of(angle: R) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    #[inline(always)]
    fn spread<L: Real>(self) -> Turn<L> {
        Turn {
            sin: L::splat(self.sin.lane(0)),
            cos: L::splat(self.cos.lane(0)),
        }
    }

    /// The sum of two angles.
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self {
            sin: self.sin.mul_add(other.cos, self.cos * other.sin),
            cos: self.cos.mul_add(other.cos, -(self.sin * other.sin)),
        }
    }

    /// A small angle more: Taylor series whose first neglected term is x^8/8!.
    #[inline(always)]
    fn further(self, x: R) -> Self {
        let c = R::splat;
        let square = x * x;
        let sin = square.mul_add(c(-1.0 / 5040.0), c(1.0 / 120.0));
        let sin = sin.mul_add(square, c(-1.0 / 6.0)).mul_add(square, c(1.0)) * x;
        let cos = square.mul_add(c(-1.0 / 720.0), c(1.0 / 24.0));
        let cos = cos.mul_add(square, c(-0.5)).mul_add(square, c(1.0));
        self.plus(Self { sin, cos })
    }
}

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
