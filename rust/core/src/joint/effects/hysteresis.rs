//! Hysteresis of a gear.

use super::{At, Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE, Twist};
use crate::parameter::{ANGLE, Parameter, Sign, TORQUE};
use crate::scalar::Real;

/// Dahl's element parallel to the gear's spring: the torque T_h z with dz/dt = (ddelta - |ddelta|
/// z) / delta_h.
///
/// The law is rate-independent and has a closed form between two reversals. It is evaluated, not
/// integrated: z stays within [-1, 1] for any `delta_h`, and a step without a reversal has a smooth
/// spring.
#[derive(Clone, Copy, Debug)]
pub struct Hysteresis<R> {
    /// T_h [N m] at the link.
    pub torque: R,
    /// delta_h [rad].
    pub twist: R,
}

impl<R: Real> Hysteresis<R> {
    /// z after a torsion change `way` [rad] without reversal: s + (z - s) exp(-|way| / delta_h),
    /// with the sign s of the change.
    #[inline(always)]
    pub fn along(&self, z: R, way: R) -> R {
        let limit = R::splat(1.0).copysign(way);
        (z - limit).mul_add((-(way.abs() / self.twist)).exp(), limit)
    }

    /// z after a time [s] between two torsions, with one reversal if the torsion rate changes sign;
    /// for scalars of one lane.
    ///
    /// The reversal is that of the cubic through both ends with their rates. The torsion is
    /// stationary there, so no derivative of its time is needed.
    #[inline(always)]
    pub fn follow(&self, z: R, from: &Twist<R>, to: &Twist<R>, time: R) -> R {
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

    /// Recoverable energy [J]: T_h delta_h z^2 / 2.
    #[inline(always)]
    pub fn stored(&self, z: R) -> R {
        R::splat(0.5) * self.torque * self.twist * z * z
    }
}

/// Extremum between 0 and 1 of `a s + b s^2 + c s^3`, whose slopes at the ends have opposite signs.
fn turning(a: f64, b: f64, c: f64) -> f64 {
    let discriminant = (b * b - 3.0 * a * c).max(0.0);
    // form of the quadratic formula without cancellation in the common case b < 0
    (a / (discriminant.sqrt().copysign(a) - b)).clamp(0.0, 1.0)
}

impl<R: Real> Effect<R> for Hysteresis<R> {
    const DECLARED: Declared = Declared {
        name: "hysteresis",
        parameters: &[
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
        ],
        sizes: 1,
        of_gear: true,
        enters: Enters {
            gear: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self {
            torque: values[0],
            twist: values[1],
        }
    }

    #[inline(always)]
    fn gear_torque(&self, z: R) -> R {
        self.torque * z
    }

    #[inline(always)]
    fn after(&self, z: R, from: &Twist<R>, to: &Twist<R>, time: R) -> R {
        self.follow(z, from, to, time)
    }

    fn energy(&self, at: &At<R>) -> R {
        self.stored(at.z)
    }

    /// T_h |ddelta| z^2.
    fn loss(&self, at: &At<R>) -> R {
        self.torque * at.twist.rate.abs() * at.z * at.z
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

    /// Dahl's law integrated by Heun's method in small steps along a torsion.
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
            // a cubic torsion over one long step of the integrator has an exact reversal
            let time = 2.5e-4;
            let angle = |t: f64| t * (rate + t * (0.5 * acceleration + t * jerk / 6.0));
            let twist = |t: f64| Twist {
                angle: angle(t),
                rate: rate + t * (acceleration + 0.5 * t * jerk),
            };
            let found = hysteresis().follow(z, &twist(0.0), &twist(time), time);
            // Two reversals between the ends are not detected. With jerks as small as these, the
            // resulting error of the reversal is below a nanoradian.
            prop_assert!((found - integrated(z, angle, time)).abs() < 2e-5);
        }

        #[test]
        fn a_loop_takes_energy_out(z in -1.0..1.0f64, way in 1e-6..1e-3f64) {
            let law = hysteresis();
            // the work is the integral of T_h z over the torsion
            let works = |z: f64, way: f64| {
                let limit = way.signum();
                let decayed = law.twist * (1.0 - (-way.abs() / law.twist).exp());
                law.torque * (limit * way + (z - limit) * decayed * limit)
            };
            let far = law.along(z, way);
            let back = law.along(far, -way);
            let stored = law.stored(back) - law.stored(z);
            prop_assert!(works(z, way) + works(far, -way) >= stored - 1e-15);
        }
    }
}
