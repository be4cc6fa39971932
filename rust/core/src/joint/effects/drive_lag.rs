//! Lag of a drive beyond the current loop of the study.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{Parameter, Sign, TIME};
use crate::scalar::Real;

/// Limit of T/tau: at this value exp(-T/tau) is below rounding.
const MAX_TIME_RATIO: f64 = 40.0;

/// The effective voltage m follows the commanded u by tau dm/dt = u - m. Over a time T of constant
/// u its mean is u - (u - m) (tau/T) (1 - exp(-T/tau)), and its end u - (u - m) exp(-T/tau). Both
/// and their derivatives are regular at tau = 0.
#[derive(Clone, Copy, Debug)]
pub struct DriveLag<R> {
    /// tau [s].
    pub time_constant: R,
}

impl<R: Real> Effect<R> for DriveLag<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
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
        affects: AffectedTerms {
            drive: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            time_constant: values[0],
        }
    }

    #[inline(always)]
    fn hold_voltage(&self, voltage: R, memory: R, time: f64) -> [R; 2] {
        let divisor = self.time_constant.max(R::splat(time / MAX_TIME_RATIO));
        let decay = (R::splat(-time) / divisor).exp();
        let difference = voltage - memory;
        let share = R::splat(1.0 / time) * self.time_constant * (R::splat(1.0) - decay);
        [voltage - difference * share, voltage - difference * decay]
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
    fn derivative_at_zero_lag_is_analytic() {
        let (time, voltage) = (1e-3, Jet::constant(8.0));
        let [mean, end] = lag(0.0).hold_voltage(voltage, Jet::constant(-4.0), time);
        assert_eq!((mean.value, end.value), (8.0, 8.0));
        assert!((mean.tangent + 12.0 / time).abs() < 1e-9);
        assert_eq!(end.tangent, 0.0);
    }

    proptest! {
        /// Two periods in a row equal one of both lengths.
        #[test]
        fn mean_and_end_match_exponential(
            tau in 1e-5..1e-2f64, from in -10.0..10.0f64, to in -10.0..10.0f64, share in 0.1..0.9f64
        ) {
            let lag = DriveLag { time_constant: tau };
            let time = 1e-3;
            let [mean, end] = lag.hold_voltage(to, from, time);
            prop_assert!((end - to - (from - to) * (-time / tau).exp()).abs() < 1e-12);
            let [first, between] = lag.hold_voltage(to, from, share * time);
            let [second, last] = lag.hold_voltage(to, between, (1.0 - share) * time);
            prop_assert!((last - end).abs() < 1e-12);
            prop_assert!((share * first + (1.0 - share) * second - mean).abs() < 1e-12);
        }

        #[test]
        fn derivative_matches_difference(tau in 1e-4..5e-3f64, from in -10.0..10.0f64) {
            let held = |tau: f64| DriveLag { time_constant: tau }.hold_voltage(5.0, from, 1e-3);
            let h = 1e-5 * tau;
            let (up, down) = (held(tau + h), held(tau - h));
            let exact = lag(tau).hold_voltage(Jet::constant(5.0), Jet::constant(from), 1e-3);
            for k in 0..2 {
                let slope = (up[k] - down[k]) / (2.0 * h);
                prop_assert!((exact[k].tangent - slope).abs() < 1e-5 * (1.0 + slope.abs()));
            }
        }
    }
}
