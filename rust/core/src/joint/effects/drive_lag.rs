//! Lag of a drive beyond the current loop of the study.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign, TIME};
use crate::scalar::Real;

/// Limit of T/tau: at this value exp(-T/tau) is below rounding.
const LONGEST: f64 = 40.0;

/// The effective voltage m follows the commanded u by tau dm/dt = u - m. Over a time T of constant
/// u its mean is u - (u - m) (tau/T) (1 - exp(-T/tau)), and its end u - (u - m) exp(-T/tau). Both
/// and their derivatives are regular at tau = 0.
#[derive(Clone, Copy, Debug)]
pub struct DriveLag<R> {
    /// tau [s].
    pub time_constant: R,
}

impl<R: Real> Effect<R> for DriveLag<R> {
    const DECLARED: Declared = Declared {
        name: "drive-lag",
        parameters: &[Parameter::new(
            "drive_lag",
            "tau_u",
            "time constant in which the drive follows a voltage",
            TIME,
            Sign::NonNegative,
        )],
        sizes: 1,
        of_gear: false,
        enters: Enters {
            drive: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self {
            time_constant: values[0],
        }
    }

    #[inline(always)]
    fn held(&self, voltage: R, memory: R, time: f64) -> [R; 2] {
        let divisor = self.time_constant.max(R::splat(time / LONGEST));
        let left = (R::splat(-time) / divisor).exp();
        let behind = voltage - memory;
        let share = R::splat(1.0 / time) * self.time_constant * (R::splat(1.0) - left);
        [voltage - behind * share, voltage - behind * left]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Jet;
    use proptest::prelude::*;

    fn lag(value: f64) -> DriveLag<Jet<f64>> {
        DriveLag {
            time_constant: Jet {
                value,
                tangent: 1.0,
            },
        }
    }

    #[test]
    fn without_a_lag_a_little_of_it_takes_from_a_jump() {
        let (time, voltage) = (1e-3, Jet::constant(8.0));
        let [mean, end] = lag(0.0).held(voltage, Jet::constant(-4.0), time);
        assert_eq!((mean.value, end.value), (8.0, 8.0));
        assert!((mean.tangent + 12.0 / time).abs() < 1e-9);
        assert_eq!(end.tangent, 0.0);
    }

    proptest! {
        /// Two periods in a row equal one of both lengths.
        #[test]
        fn the_mean_is_that_of_the_exponential(
            tau in 1e-5..1e-2f64, from in -10.0..10.0f64, to in -10.0..10.0f64, share in 0.1..0.9f64
        ) {
            let lag = DriveLag { time_constant: tau };
            let time = 1e-3;
            let [mean, end] = lag.held(to, from, time);
            prop_assert!((end - to - (from - to) * (-time / tau).exp()).abs() < 1e-12);
            let [first, between] = lag.held(to, from, share * time);
            let [second, last] = lag.held(to, between, (1.0 - share) * time);
            prop_assert!((last - end).abs() < 1e-12);
            prop_assert!((share * first + (1.0 - share) * second - mean).abs() < 1e-12);
        }

        #[test]
        fn its_derivative_is_a_difference(tau in 1e-4..5e-3f64, from in -10.0..10.0f64) {
            let held = |tau: f64| DriveLag { time_constant: tau }.held(5.0, from, 1e-3);
            let h = 1e-5 * tau;
            let (up, down) = (held(tau + h), held(tau - h));
            let exact = lag(tau).held(Jet::constant(5.0), Jet::constant(from), 1e-3);
            for k in 0..2 {
                let slope = (up[k] - down[k]) / (2.0 * h);
                prop_assert!((exact[k].tangent - slope).abs() < 1e-5 * (1.0 + slope.abs()));
            }
        }
    }
}
