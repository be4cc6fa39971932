//! What real gears and motors add to springs and dry friction, each on request.
//!
//! All of it costs exponentials and sines in the innermost loop, so a [`crate::plant::Plant`] says at
//! compile time whether it has any.

use crate::parameter::{ANGLE, Parameter, Sign, TORQUE, VELOCITY};
use crate::scalar::Real;

/// Which of the effects a joint has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EffectKinds {
    /// Friction that is largest at rest.
    pub stribeck: bool,
    /// A gear whose torque lags its twist.
    pub hysteresis: bool,
    /// A gear whose ratio changes twice a motor turn.
    pub kinematic_error: bool,
}

/// Of [`Stribeck`], its size first.
const STRIBECK: [Parameter; 2] = [
    Parameter::new(
        "stribeck_friction",
        "f_S",
        "excess of the friction at standstill over Coulomb friction",
        TORQUE,
        Sign::NonNegative,
    ),
    Parameter::new(
        "stribeck_velocity",
        "w_s",
        "motor velocity at which 1/e of the Stribeck friction is left",
        VELOCITY,
        Sign::Positive,
    ),
];
/// Of [`Hysteresis`], its size first.
const HYSTERESIS: [Parameter; 2] = [
    Parameter::new(
        "hysteresis_torque",
        "T_h",
        "largest torque of the gear's hysteresis, at the link",
        TORQUE,
        Sign::NonNegative,
    ),
    Parameter::new(
        "hysteresis_twist",
        "delta_h",
        "torsion in which the hysteresis reverses, at the link",
        ANGLE,
        Sign::Positive,
    ),
];
/// Of [`KinematicError`], both sizes.
const KINEMATIC_ERROR: [Parameter; 2] = [
    Parameter::new(
        "kinematic_error_cos",
        "a",
        "cosine part of the gear's kinematic error, at the link",
        ANGLE,
        Sign::Any,
    ),
    Parameter::new(
        "kinematic_error_sin",
        "b",
        "sine part of the gear's kinematic error, at the link",
        ANGLE,
        Sign::Any,
    ),
];

impl EffectKinds {
    /// The parameters that say how large an effect is.
    const SIZES: [&'static str; 4] = [
        STRIBECK[0].name,
        HYSTERESIS[0].name,
        KINEMATIC_ERROR[0].name,
        KINEMATIC_ERROR[1].name,
    ];

    /// The effects by name, with their parameters.
    pub(crate) fn declared() -> [(&'static str, &'static [Parameter]); 3] {
        [
            ("stribeck", &STRIBECK),
            ("hysteresis", &HYSTERESIS),
            ("kinematic-error", &KINEMATIC_ERROR),
        ]
    }

    /// Whether there is any.
    pub fn any(self) -> bool {
        self != Self::default()
    }

    /// Where the `k`-th of all sizes that effects have stands among these effects' parameters.
    pub(crate) fn place(self, k: usize) -> Option<usize> {
        let size = Self::SIZES[k];
        self.parameters().iter().position(|own| own.name == size)
    }

    /// Which of all sizes that effects have a parameter is; none of a velocity or a torsion.
    pub(crate) fn size(self, place: usize) -> Option<usize> {
        let name = self.parameters()[place].name;
        Self::SIZES.iter().position(|&size| size == name)
    }

    /// The effects' parameters.
    pub(crate) fn parameters(self) -> Vec<Parameter> {
        let has = [self.stribeck, self.hysteresis, self.kinematic_error];
        let own = Self::declared().into_iter().zip(has);
        own.filter(|(_, has)| *has)
            .flat_map(|((_, own), _)| own.to_vec())
            .collect()
    }
}

/// The effects of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Effects<R> {
    /// Friction that is largest at rest.
    pub stribeck: Option<Stribeck<R>>,
    /// A gear whose torque lags its twist.
    pub hysteresis: Option<Hysteresis<R>>,
    /// A gear whose ratio changes twice a motor turn.
    pub kinematic_error: Option<KinematicError<R>>,
}

impl<R: Real> Effects<R> {
    /// Those of the given kinds, their parameters taken in the order of their names.
    pub(crate) fn of(kinds: EffectKinds, mut take: impl FnMut() -> R) -> Self {
        let mut pair = |has: bool| has.then(|| [take(), take()]);
        let stribeck = pair(kinds.stribeck);
        let hysteresis = pair(kinds.hysteresis);
        let kinematic_error = pair(kinds.kinematic_error);
        Self {
            stribeck: stribeck.map(|[friction, velocity]| Stribeck { friction, velocity }),
            hysteresis: hysteresis.map(|[torque, twist]| Hysteresis { torque, twist }),
            kinematic_error: kinematic_error.map(|[cos, sin]| KinematicError { cos, sin }),
        }
    }
}

/// Friction beyond Coulomb's that goes away as the motor gets faster: f_S exp(-(dtheta_M/w_s)^2).
#[derive(Clone, Copy, Debug)]
pub struct Stribeck<R> {
    /// f_S [N m] at the motor.
    pub friction: R,
    /// w_s [rad/s] of the motor.
    pub velocity: R,
}

impl<R: Real> Stribeck<R> {
    /// What is left of it at a velocity of the motor [rad/s], in N m.
    #[inline(always)]
    pub fn at(&self, velocity: R) -> R {
        let share = velocity / self.velocity;
        self.friction * (-(share * share)).exp()
    }
}

/// Dahl's element beside a gear's spring: the torque T_h z with
/// dz/dt = (ddelta - |ddelta| z) / delta_h.
///
/// The law knows the twist's way but not its speed, and has a closed form between two reversals.
/// It is solved, not integrated: z stays within [-1, 1] however short `delta_h` is, and a step
/// without a reversal sees a smooth spring.
#[derive(Clone, Copy, Debug)]
pub struct Hysteresis<R> {
    /// T_h [N m] at the link.
    pub torque: R,
    /// delta_h [rad].
    pub twist: R,
}

/// A gear's twist [rad] and twist rate [rad/s].
#[derive(Clone, Copy, Debug)]
pub struct Twist<R> {
    /// delta.
    pub angle: R,
    /// ddelta.
    pub rate: R,
}

impl<R: Real> Hysteresis<R> {
    /// z after the twist went one way, by `way` [rad]: s + (z - s) exp(-|way| / delta_h), with s the
    /// way's sign.
    #[inline(always)]
    pub fn along(&self, z: R, way: R) -> R {
        let limit = R::splat(1.0).copysign(way);
        (z - limit).mul_add((-(way.abs() / self.twist)).exp(), limit)
    }

    /// z after a time [s] in which the twist went from one place to another, back and forth if its
    /// rate changed sign; for scalars of one lane.
    ///
    /// It turns where the cubic through both ends, with the rates there, does. The cubic is flat at
    /// that place, so that no derivative of the place itself is needed.
    #[inline(always)]
    pub fn after(&self, z: R, from: &Twist<R>, to: &Twist<R>, time: R) -> R {
        let way = to.angle - from.angle;
        if from.rate.lane(0) * to.rate.lane(0) >= 0.0 {
            return self.along(z, way);
        }
        let (begin, end) = (from.rate * time, to.rate * time);
        let square = R::splat(3.0) * way - begin - begin - end;
        let cube = begin + end - way - way;
        let at = R::splat(turning(begin.lane(0), square.lane(0), cube.lane(0)));
        let there = cube.mul_add(at, square).mul_add(at, begin) * at;
        self.along(self.along(z, there), way - there)
    }

    /// What can be got back of the work done on it [J]: T_h delta_h z^2 / 2.
    #[inline(always)]
    pub fn energy(&self, z: R) -> R {
        R::splat(0.5) * self.torque * self.twist * z * z
    }

    /// Power [W] that it takes out: T_h |ddelta| z^2.
    #[inline(always)]
    pub fn loss(&self, z: R, rate: R) -> R {
        self.torque * rate.abs() * z * z
    }
}

/// Where between 0 and 1 `a s + b s^2 + c s^3`, whose slopes there have opposite signs, turns.
fn turning(a: f64, b: f64, c: f64) -> f64 {
    let discriminant = (b * b - 3.0 * a * c).max(0.0);
    // of the two forms of the quadratic's root the one that does not cancel in the common case b < 0
    (a / (discriminant.sqrt().copysign(a) - b)).clamp(0.0, 1.0)
}

/// The link's angle is off by e = a cos(2 theta_M) + b sin(2 theta_M): the wave generator has two
/// lobes, and no gear is round.
#[derive(Clone, Copy, Debug)]
pub struct KinematicError<R> {
    /// a [rad] at the link.
    pub cos: R,
    /// b [rad] at the link.
    pub sin: R,
}

impl<R: Real> KinematicError<R> {
    /// e(theta_M) [rad] and its derivative e'(theta_M).
    #[inline(always)]
    pub fn at(&self, motor_angle: R) -> [R; 2] {
        let (sin, cos) = (motor_angle + motor_angle).sin_cos();
        let error = self.cos.mul_add(cos, self.sin * sin);
        let half_slope = self.sin * cos - self.cos * sin;
        [error, half_slope + half_slope]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hysteresis() -> Hysteresis<f64> {
        Hysteresis {
            torque: 2.0,
            twist: 1.5e-4,
        }
    }

    /// Dahl's law by many small steps of Heun's method along a given twist.
    fn integrated(z: f64, twist: impl Fn(f64) -> f64, time: f64) -> f64 {
        let law = hysteresis();
        let steps = 100_000;
        let h = time / f64::from(steps);
        let mut z = z;
        for k in 0..steps {
            let way = twist(f64::from(k + 1) * h) - twist(f64::from(k) * h);
            let slope = |z: f64| (way - way.abs() * z) / law.twist;
            let first = slope(z);
            z += 0.5 * (first + slope(z + first));
        }
        z
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn one_way_is_the_solution_of_dahls_law(z in -1.0..1.0f64, way in -1e-3..1e-3f64) {
            let found = hysteresis().along(z, way);
            prop_assert!((found - integrated(z, |t| way * t, 1.0)).abs() < 1e-9);
            prop_assert!(found.abs() <= 1.0);
        }

        #[test]
        fn back_and_forth_is_too(
            z in -1.0..1.0f64, rate in -0.1..0.1f64, acceleration in -800.0..800.0f64, jerk in -1e5..1e5f64,
        ) {
            // A cubic twist over one long step of the integrator: the turning point is exact.
            let time = 2.5e-4;
            let angle = |t: f64| t * (rate + t * (0.5 * acceleration + t * jerk / 6.0));
            let twist = |t: f64| Twist {
                angle: angle(t),
                rate: rate + t * (acceleration + 0.5 * t * jerk),
            };
            let found = hysteresis().after(z, &twist(0.0), &twist(time), time);
            // Where the rate changes sign twice no end tells; jerks as small as these do not do that
            // by more than a nanoradian.
            prop_assert!((found - integrated(z, angle, time)).abs() < 2e-5);
        }

        #[test]
        fn a_loop_takes_energy_out(z in -1.0..1.0f64, way in 1e-6..1e-3f64) {
            let law = hysteresis();
            // the work is the integral of T_h z along the way
            let works = |z: f64, way: f64| {
                let limit = way.signum();
                let decayed = law.twist * (1.0 - (-way.abs() / law.twist).exp());
                law.torque * (limit * way + (z - limit) * decayed * limit)
            };
            let far = law.along(z, way);
            let back = law.along(far, -way);
            let stored = law.energy(back) - law.energy(z);
            prop_assert!(works(z, way) + works(far, -way) >= stored - 1e-15);
        }

        #[test]
        fn the_error_has_its_slope(theta in -50.0..50.0f64, cos in -2e-4..2e-4f64, sin in -2e-4..2e-4f64) {
            let error = KinematicError { cos, sin };
            let h = 1e-4;
            let slope = (error.at(theta + h)[0] - error.at(theta - h)[0]) / (2.0 * h);
            // of a sine of 2 theta: h^2 / 6 of its third derivative, eightfold
            prop_assert!((error.at(theta)[1] - slope).abs() < 1e-11);
            prop_assert!((error.at(theta + std::f64::consts::PI)[0] - error.at(theta)[0]).abs() < 1e-17);
        }
    }

    #[test]
    fn stribecks_friction_is_all_there_at_rest_and_gone_at_speed() {
        let law = Stribeck {
            friction: 0.02,
            velocity: 3.0,
        };
        assert_eq!(law.at(0.0), 0.02);
        assert!((law.at(-3.0) - 0.02 * (-1.0f64).exp()).abs() < 1e-17);
        assert!(law.at(30.0) < 1e-40);
    }
}
