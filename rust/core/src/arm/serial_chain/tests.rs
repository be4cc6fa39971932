//! Tests of the parent module.

use super::*;
use crate::arm::{TwoLink, differentiation};
use proptest::prelude::*;

/// A chain without parallel axes; every third joint is prismatic.
fn chain<const N: usize>() -> SerialChain<N> {
    let joint = |i: usize| {
        let k = i as f64;
        ChainJoint {
            joint_type: match i % 3 {
                1 => JointType::Prismatic,
                _ => JointType::Revolute,
            },
            position: [0.3, 0.05 * k, -0.1],
            attitude: [0.4 - 0.2 * k, 0.5 * k - 0.7, 0.3],
            axis: [0.3 * k, -0.4, 1.0],
            accelerometer_distance: 0.3,
        }
    };
    let joints: Vec<ChainJoint> = (0..N).map(joint).collect();
    SerialChain::new(&joints, [0.5, -0.3, -9.8]).expect("axes")
}

/// Torques with one parameter at one and the others at zero, parameter by parameter.
fn unit_torques<const N: usize>(
    arm: &SerialChain<N>,
    q: &[f64; N],
    dq: &[f64; N],
    ddq: &[f64; N],
) -> Vec<[f64; N]> {
    let at = arm.posture(q);
    let count = arm.names().len();
    let unit = |k: usize| (0..count).map(|i| f64::from(i == k)).collect::<Vec<_>>();
    let torques = |k: usize| arm.torques(&arm.base(&unit(k)), &at, dq, ddq);
    (0..count).map(torques).collect()
}

/// Different links of about 4 kg and 0.3 m.
fn bodies<const N: usize>() -> Vec<f64> {
    let body = |k: usize| {
        let x = 0.01 * k as f64;
        [
            4.0 + x,
            0.3,
            -0.1,
            0.1 + x,
            0.3,
            0.01,
            0.35 + x,
            -0.02,
            0.01,
            0.4,
        ]
    };
    (0..N).flat_map(body).collect()
}

/// Identities between the recursions; torques are of the order of 100 N m.
fn check<const N: usize>([q, dq, ddq]: &[[f64; N]; 3]) {
    let (arm, values) = (chain::<N>(), bodies::<N>());
    assert_eq!(arm.check(&values, &[None; N]), Ok(()));
    let (base, at) = (arm.base(&values), arm.posture(q));
    let near = |one: f64, other: f64| {
        assert!(
            (one - other).abs() < 1e-11 * (100.0 + one.abs()),
            "{one} {other}"
        );
    };
    let torques = arm.torques(&base, &at, dq, ddq);
    let (inertia, bias) = (arm.inertia(&base, &at), arm.bias(&base, &at, dq));
    let (regressor, units) = (arm.regressor(&at, dq, ddq), unit_torques(&arm, q, dq, ddq));
    for i in 0..N {
        let accelerated: f64 = (0..N).map(|j| inertia[i][j] * ddq[j]).sum();
        near(torques[i], accelerated + bias[i]);
        for (column, unit) in regressor.as_ref().iter().zip(&units) {
            near(column[i], unit[i]);
        }
        let columns = units.iter().zip(&values);
        near(
            torques[i],
            columns.map(|(column, value)| column[i] * value).sum(),
        );
    }
    let (slopes, other) = (
        arm.slopes(&base, &at, dq, ddq),
        differentiation::slopes(&arm, &base, (&at, dq, ddq)),
    );
    for (slope, other) in [
        (slopes.angle, other.angle),
        (slopes.velocity, other.velocity),
    ] {
        for (row, other) in slope.iter().zip(&other) {
            for (entry, other) in row.iter().zip(other) {
                near(*entry, *other);
            }
        }
    }
    // a nearby position, and the work of gravity, which depends on the position only
    let increment = std::array::from_fn(|i| 1e-5 * (1.0 + dq[i]));
    let ends = [1.0, -1.0].map(|side| arm.near(&at, &increment.map(|x| side * x)));
    let gained = arm.potential(&base, &ends[0]) - arm.potential(&base, &ends[1]);
    let gravity = arm.bias(&base, &at, &[0.0; N]);
    let work: f64 = (0..N).map(|i| 2.0 * increment[i] * gravity[i]).sum();
    // the cube of steps of about 1e-4 rad in all, times energies of the order of 100 J
    assert!((gained - work).abs() < 1e-9, "{gained} {work}");
}

proptest! {
    #[test]
    fn recursions_agree(motion in prop::array::uniform3(prop::array::uniform6(-2.0..2.0f64))) {
        check(&motion.map(|row| [row[0]]));
        check(&motion.map(|row| [row[0], row[1]]));
        check(&motion.map(|row| [row[0], row[1], row[2]]));
        check(&motion);
    }

    #[test]
    fn planar_two_link_chain_agrees_with_closed_form(motion in prop::array::uniform3(prop::array::uniform2(-2.0..2.0f64))) {
        let (l, g, distance) = (0.35, 9.81, [0.33, 0.27]);
        let joint = |index: usize| ChainJoint {
            joint_type: JointType::Revolute,
            position: [l * index as f64, 0.0, 0.0],
            attitude: [0.0; 3],
            axis: [0.0, 0.0, 1.0],
            accelerometer_distance: distance[index],
        };
        let chain: SerialChain<2> = SerialChain::new(&[joint(0), joint(1)], [0.0, -g, 0.0]).expect("axes");
        let planar = TwoLink::<true> { link_length: l, gravity: g, accelerometer_distance: distance };
        let [[m, h, i], [m_2, h_2, i_2]] = [[6.0, 0.9, 0.5], [3.0, 0.4, 0.3]];
        let body = |m, h, i: f64| [m, h, 0.0, 0.0, 0.6 * i, 0.0, i, 0.0, 0.0, i];
        let bodies_of_chain = [body(m, h, i), body(m_2, h_2, i_2)];
        let of_planar = planar.base(&[i + m_2 * l * l, i_2, l * h_2, g * (h + m_2 * l), g * h_2]);
        let [q, dq, ddq] = &motion;
        let (at, at_planar) = (chain.posture(q), planar.posture(q));
        let pairs = [
            (chain.torques(&chain.base(bodies_of_chain.as_flattened()), &at, dq, ddq), planar.torques(&of_planar, &at_planar, dq, ddq)),
            (chain.accelerometers(&at, dq, ddq), planar.accelerometers(&at_planar, dq, ddq)),
            (chain.absolute_rates(&at, dq), planar.absolute_rates(&at_planar, dq)),
        ];
        let signals = [chain.link_signals(&at, dq, ddq), planar.link_signals(&at_planar, dq, ddq)];
        let all = [pairs.map(|pair| pair.0).to_vec(), signals[0].to_vec()].concat();
        let others = [pairs.map(|pair| pair.1).to_vec(), signals[1].to_vec()].concat();
        for (one, other) in all.as_flattened().iter().zip(others.as_flattened()) {
            prop_assert!((one - other).abs() < 1e-12 * 100.0, "{} {}", one, other);
        }
    }
}

#[test]
fn impossible_inertias_are_rejected() {
    let (arm, values) = (chain::<2>(), bodies::<2>());
    let changed = |index: usize, value| {
        let mut values = values.clone();
        values[index] = value;
        arm.check(&values, &[None; 2]).map_err(|(index, _)| index)
    };
    assert_eq!(changed(10, 0.0), Err(10));
    assert_eq!(changed(9, -10.0), Err(4));
    assert_eq!(changed(19, -10.0), Err(4)); // a body on a prismatic joint turns about the first
    assert_eq!(changed(4, 1.0), Ok(())); // no body has it, but other links give the same torques
}
