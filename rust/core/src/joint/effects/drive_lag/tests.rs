//! Tests of the parent module.

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
