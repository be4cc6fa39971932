//! Tests of the parent module.

use super::*;
use crate::arm::{JointType, OneLink, TwoLink};
use proptest::prelude::*;

/// Compares closed forms with forward differentiation, relative to numbers of about ten.
fn check<A: Arm<N>, const N: usize>(arm: &A, values: &[f64], [q, dq, ddq]: &[[f64; N]; 3]) {
    let (base, at) = (arm.base(values), arm.posture(q));
    let motion = (&at, dq, ddq);
    let near = |closed_form: &[[f64; N]], other: &[[f64; N]]| {
        for (closed_form, other) in closed_form.as_flattened().iter().zip(other.as_flattened()) {
            assert!(
                (closed_form - other).abs() < 1e-12 * 10.0,
                "{closed_form} {other}"
            );
        }
    };
    let (closed_form, other) = (arm.slopes(&base, &at, dq, ddq), slopes(arm, &base, motion));
    near(&closed_form.angle, &other.angle);
    near(&closed_form.velocity, &other.velocity);
    let (closed_form, by) = arm.accelerometer_slopes(&at, dq, ddq);
    let (other, other_by) = accelerometer_slopes(arm, motion);
    near(&closed_form.angle, &other.angle);
    near(&closed_form.velocity, &other.velocity);
    near(&by, &other_by);
    let regressor = arm.regressor(&at, dq, ddq);
    let torques = arm.torques(&base, &at, dq, ddq);
    for i in 0..N {
        let columns = regressor.as_ref().iter().zip(values);
        let sum: f64 = columns.map(|(column, value)| column[i] * value).sum();
        assert!((sum - torques[i]).abs() < 1e-12 * 10.0);
    }
}

proptest! {
    #[test]
    fn closed_forms_agree_with_differentiation(motion in prop::array::uniform3(prop::array::uniform2(-2.0..2.0f64))) {
        let values = [1.6, 0.6, 0.8, 3.1, 0.7];
        let (link_length, gravity) = (0.35, 9.81);
        let accelerometer_distance = [0.33, 0.27];
        check(&TwoLink::<false> { link_length, gravity, accelerometer_distance }, &values, &motion);
        check(&TwoLink::<true> { link_length, gravity, accelerometer_distance }, &values, &motion);
        let (motion, accelerometer_distance) = (motion.map(|[first, _]| [first]), 0.3);
        check(&OneLink { joint_type: JointType::Revolute, gravity, accelerometer_distance }, &values[..2], &motion);
    }
}
