//! Tests of the parent module.

use super::*;
use proptest::prelude::*;

fn hysteresis() -> Hysteresis<f64> {
    Hysteresis {
        torque: 2.0,
        reversal_torsion: 1.5e-4,
    }
}

/// Dahl's law integrated by Heun's method in small steps along a torsion.
fn integrated(z: f64, torsion: impl Fn(f64) -> f64, time: f64) -> f64 {
    let law = hysteresis();
    let steps = 100_000;
    let h = time / f64::from(steps);
    let mut z = z;
    for k in 0..steps {
        let change = torsion(f64::from(k + 1) * h) - torsion(f64::from(k) * h);
        let slope = |z: f64| (change - change.abs() * z) / law.reversal_torsion;
        let first = slope(z);
        z += 0.5 * (first + slope(z + first));
    }
    z
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn relax_solves_dahls_law(z in -1.0..1.0f64, change in -1e-3..1e-3f64) {
        let actual = hysteresis().relax(z, change);
        prop_assert!((actual - integrated(z, |t| change * t, 1.0)).abs() < 1e-9);
        prop_assert!(actual.abs() <= 1.0);
    }

    #[test]
    fn state_after_reversal_solves_dahls_law(
        z in -1.0..1.0f64, rate in -0.1..0.1f64, acceleration in -800.0..800.0f64, jerk in -1e5..1e5f64,
    ) {
        // a cubic torsion over one long step of the integrator has an exact reversal
        let time = 2.5e-4;
        let angle = |t: f64| t * (rate + t * (0.5 * acceleration + t * jerk / 6.0));
        let torsion = |t: f64| Torsion {
            angle: angle(t),
            rate: rate + t * (acceleration + 0.5 * t * jerk),
        };
        let actual = hysteresis().state_after(z, &torsion(0.0), &torsion(time), time);
        // Two reversals between the ends are not detected. With jerks as small as these, the
        // resulting error of the reversal is below a nanoradian.
        prop_assert!((actual - integrated(z, angle, time)).abs() < 2e-5);
    }

    #[test]
    fn closed_loop_dissipates_energy(z in -1.0..1.0f64, change in 1e-6..1e-3f64) {
        let law = hysteresis();
        // the work is the integral of T_h z over the torsion
        let work = |z: f64, change: f64| {
            let limit = change.signum();
            let decayed = law.reversal_torsion * (1.0 - (-change.abs() / law.reversal_torsion).exp());
            law.torque * (limit * change + (z - limit) * decayed * limit)
        };
        let advanced = law.relax(z, change);
        let returned = law.relax(advanced, -change);
        let increase = law.stored_energy(returned) - law.stored_energy(z);
        prop_assert!(work(z, change) + work(advanced, -change) >= increase - 1e-15);
    }
}
