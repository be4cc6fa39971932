//! Tests of the parent module.

use super::*;
use proptest::prelude::*;

fn three_slope(k: [f64; 3], t: [f64; 2]) -> ThreeSlopeSpring<f64> {
    ThreeSlope::spring(&[k[0], k[1], k[2], t[0], t[1], 0.0, 0.0], CORNER)
}

fn sharp(k: [f64; 3], t: [f64; 2], delta: f64) -> f64 {
    let d1 = t[0] / k[0];
    let d2 = d1 + (t[1] - t[0]) / k[1];
    let x = delta.abs();
    let torque = if x < d1 {
        k[0] * x
    } else if x < d2 {
        t[0] + k[1] * (x - d1)
    } else {
        t[1] + k[2] * (x - d2)
    };
    torque.copysign(delta)
}

proptest! {
    #[test]
    fn differs_from_sharp_law_only_at_corners(
        k1 in 1e3..3e4, ratio2 in 0.7..2.0, ratio3 in 0.7..2.0,
        t1 in 1.0..20.0, more in 1.0..30.0, delta in -5e-3..5e-3,
    ) {
        let k = [k1, k1 * ratio2, k1 * ratio2 * ratio3];
        let t = [t1, t1 + more];
        let spring = three_slope(k, t);
        let bound = 0.25 * CORNER * (f64::abs(k[1] - k[0]) + f64::abs(k[2] - k[1]));
        prop_assert!((spring.torque(delta) - sharp(k, t, delta)).abs() <= bound + 1e-10);
        prop_assert_eq!(spring.torque(-delta), -spring.torque(delta));
    }
}

#[test]
fn torsion_converges_where_newton_cycles() {
    let spring = three_slope([1e3, 8.1e3, 0.81e3], [10.5, 32.9]);
    let torsion: f64 = spring.torsion(23.2);
    assert!((spring.torque(torsion) - 23.2).abs() < 1e-12);
}
