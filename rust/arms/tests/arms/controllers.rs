//! Controllers: control laws against closed forms, and derivatives of experiments in closed loop.

use std::iter::zip;

use crate::common::{
    LINEAR, RIGID, clock, config, differentiate_over_dual_numbers, level_joint, linear_laws, scara,
    sensitivities, simulate,
};
use strainwave_core::actuation::{
    Controller, JointLaw, LawState, LinearServo, MAX_LAW_STATES, PiPosition, PiVelocity, Servo,
};
use strainwave_core::arm::{OneLink, TwoLink};
use strainwave_core::experiment::{Initial, Member, Quantity, Source, Task};
use strainwave_core::program::Width;

/// Servo period [s].
const PERIOD: f64 = 1e-3;

fn pi_velocity<const N: usize>(kp: f64, ki: f64) -> PiVelocity<N> {
    PiVelocity {
        kp: [kp; N],
        ki: [ki; N],
        limit: 12.0,
        period: PERIOD,
        active: [true; N],
    }
}

/// Both kinds of loops.
fn loops<const N: usize>() -> [Servo<N>; 2] {
    let velocity = pi_velocity(0.6, 9.0);
    let position_gain = [8.0; N];
    [
        Servo::PiVelocity(velocity),
        Servo::PiPosition(PiPosition {
            velocity,
            position_gain,
        }),
    ]
}

/// The loops, and linear laws that are equal to them.
fn servos<const N: usize>() -> [Servo<N>; 4] {
    let [velocity, position] = loops();
    let laws = [linear_laws(&velocity), linear_laws(&position)];
    let [of_velocity, of_position] = laws.map(Servo::LinearServo);
    [velocity, position, of_velocity, of_position]
}

/// Linear laws move the arm as the loops that they are equal to: free, limited, with feed-forward,
/// and with a joint without servo. The velocity is a difference of angles in both, with different
/// rounding; the tolerance is that of kp / period times the rounding of an angle.
#[test]
fn linear_laws_equal_loops() {
    let samples = 800;
    let parameters = scara(1.0, 1.0);
    let reference: Vec<[f64; 2]> = (0..samples)
        .map(|k| [0.02, 0.05].map(|w| 60.0 * (w * k as f64).sin()))
        .collect();
    let feed_forward: Vec<[f64; 2]> = (0..samples)
        .map(|k| [1.0, 0.5].map(|volts| volts * (0.01 * k as f64).cos()))
        .collect();
    let member = Member {
        parameters: &parameters,
        feed_forward: &feed_forward,
        reference: &reference,
        initial: Initial {
            voltage: [1.0, 0.5],
            ..at_rest()
        },
    };
    for mut servo in loops::<2>() {
        for (limit, active) in [(1e3, [true; 2]), (3.0, [true; 2]), (3.0, [false, true])] {
            let (Servo::PiVelocity(velocity) | Servo::PiPosition(PiPosition { velocity, .. })) =
                &mut servo
            else {
                unreachable!("a loop")
            };
            (velocity.limit, velocity.active) = (limit, active);
            let run = |servo: Servo<2>| {
                let task = Task {
                    config: config::<TwoLink<true>, 2>([LINEAR; 2]),
                    clock: clock(samples),
                    servo: Some(servo),
                    record: vec![Quantity::Voltage, Quantity::MotorVelocity],
                    link_sensors: Vec::new(),
                };
                simulate(&task, &member, Width::detect()).expect("finite")
            };
            let one = run(servo.clone());
            let other = run(Servo::LinearServo(linear_laws(&servo)));
            let is_limited = |volts: &[f64; 2]| volts[1].abs() == limit;
            let limited = one[0].iter().filter(|volts| is_limited(volts)).count();
            assert_eq!(limited > 10, limit == 3.0, "{limited} limited samples");
            for (one, other) in zip(one.concat(), other.concat()) {
                for (one, other) in zip(one, other) {
                    assert!((one - other).abs() < 1e-9, "{one} {other}");
                }
            }
        }
    }
}

/// E multiplies the limited voltage without the feed-forward, and only states that hold keep their
/// value.
#[test]
fn laws_observe_the_limited_voltage() {
    let mut integral = LawState {
        a: [0.0; MAX_LAW_STATES],
        b: [0.0, 1.0, 0.0],
        c: 1.0,
        e: 0.0,
        holds: true,
        rest: [0.0; 2],
    };
    let observer = LawState {
        e: 1.0,
        holds: false,
        rest: [2.0, 3.0],
        ..integral
    };
    integral.a[1] = 1.0;
    let law = JointLaw::new(vec![observer, integral], [0.0, 10.0, 0.0]);
    let servo = LinearServo::<1> {
        laws: [law].into(),
        limit: 12.0,
        period: PERIOD,
    };
    let mut memory = servo.at_rest(&[0.5], &[0.25]); // 2 * 0.25 + 3 * 0.5, and 0
    // v = 2, u = 2 + 1
    assert_eq!(servo.command(&mut memory, &[0.0], &[0.25], &[1.0]), [3.0]);
    // the observer has u - 1 = 2, so v = 2 + 10, and u = 12 is limited
    assert_eq!(servo.command(&mut memory, &[1.0], &[0.25], &[1.0]), [12.0]);
    // the observer has w + u - 1 = 1 + 11, and the integral has not changed
    assert_eq!(servo.command(&mut memory, &[0.0], &[0.25], &[-9.0]), [3.0]);
    assert!(JointLaw::new(vec![integral; MAX_LAW_STATES + 1], [0.0; 3]).is_none());
}

#[test]
fn position_loop_equals_velocity_loop_with_corrected_reference() {
    let velocity = pi_velocity::<1>(0.4, 3.0);
    let position = PiPosition {
        velocity,
        position_gain: [5.0],
    };
    let (mut outer, mut inner) = (
        position.at_rest(&[0.7], &[2.0]),
        velocity.at_rest(&[0.7], &[2.0]),
    );
    let mut path = 2.0;
    for (k, angle) in [2.0, 2.01, 2.03, 2.02, 2.05, 9.0, 2.0]
        .into_iter()
        .enumerate()
    {
        let reference = 3.0 - k as f64;
        let corrected = reference + 5.0 * (path - angle);
        path += PERIOD * reference;
        let one = position.command(&mut outer, &[reference], &[angle], &[0.1]);
        let other = velocity.command(&mut inner, &[corrected], &[angle], &[0.1]);
        assert_eq!(one, other);
    }
}

#[test]
fn limited_output_stops_integration() {
    let velocity = pi_velocity::<1>(1.0, 100.0);
    let mut memory = velocity.at_rest(&[5.0], &[0.0]);
    assert_eq!(
        velocity.command(&mut memory, &[1e6], &[0.0], &[0.0]),
        [12.0]
    );
    // the limited reading has not changed the integral: the output holds the arm as before
    assert_eq!(velocity.command(&mut memory, &[0.0], &[0.0], &[0.0]), [5.0]);
}

fn experiment(servo: Servo<1>, samples: usize) -> Task<OneLink, 1> {
    Task {
        config: level_joint(RIGID),
        clock: clock(samples),
        servo: Some(servo),
        record: vec![
            Quantity::MotorAngle,
            Quantity::MotorVelocity,
            Quantity::Voltage,
        ],
        link_sensors: Vec::new(),
    }
}

fn at_rest<const N: usize>() -> Initial<N> {
    Initial {
        motor_angle: [1.0; N],
        motor_velocity: [0.0; N],
        link_angle: None,
        link_velocity: [0.0; N],
        voltage: [0.0; N],
    }
}

/// A rigid joint with inertia J and viscous friction d under a constant reference r. The velocity
/// loop settles at velocity r. The position loop also settles on the path, except for the delay of
/// one period between encoder difference and path.
#[test]
fn loops_reach_their_reference() {
    let samples = 4000;
    let reference = vec![[20.0]; samples];
    let zeros = vec![[0.0]; samples];
    let parameters = [0.5, 0.0, 1e-4, 3e-4, 0.0, 0.0, 0.0];
    let mut lags = Vec::new();
    for servo in servos::<1>() {
        let task = experiment(servo, samples);
        let member = Member {
            parameters: &parameters,
            feed_forward: &zeros,
            reference: &reference,
            initial: at_rest(),
        };
        let record = simulate(&task, &member, Width::detect()).expect("finite");
        let last = samples - 1;
        assert!((record[1][last][0] - 20.0).abs() < 1e-6);
        lags.push(1.0 + 20.0 * PERIOD * last as f64 - record[0][last][0]);
    }
    for lags in lags.chunks(2) {
        assert!(lags[0] > 1e-3, "{lags:?}"); // a velocity loop does not remove the position error
        assert!(lags[1].abs() < 1e-5, "{lags:?}");
    }
}

/// Derivatives through the loop, by the variational equations and over dual numbers.
#[test]
fn derivatives_match_differences_in_closed_loop() {
    let samples = 300;
    let parameters = scara(1.0, 1.0);
    for servo in servos::<2>() {
        let task = Task {
            config: config::<TwoLink<true>, 2>([LINEAR; 2]),
            clock: clock(samples),
            servo: Some(servo),
            record: vec![
                Quantity::MotorAngle,
                Quantity::LinkVelocity,
                Quantity::Voltage,
            ],
            link_sensors: Vec::new(),
        };
        let reference: Vec<[f64; 2]> = (0..samples)
            .map(|k| [0.02, 0.05].map(|w| 15.0 * (w * k as f64).sin()))
            .collect();
        let zeros = vec![[0.0; 2]; samples];
        let member = Member {
            parameters: &parameters,
            feed_forward: &zeros,
            reference: &reference,
            initial: Initial {
                voltage: [1.0, 0.5],
                ..at_rest()
            },
        };
        let directions = [
            Source::Parameter(0),
            Source::Parameter(5),
            Source::Parameter(10),
            Source::Parameter(15),
            Source::MotorAngle(0),
            Source::MotorVelocity(1),
        ];
        let width = Width::detect();
        let fast = sensitivities(&task, &member, &directions, width).expect("finite");
        let slow = differentiate_over_dual_numbers(&task, &member, &directions).expect("finite");
        for (fast, slow) in zip(&fast.tangents, &slow.tangents) {
            for d in 0..directions.len() {
                let column = slow.iter().skip(d).step_by(directions.len());
                let largest = column.fold(0.0f64, |largest, one| largest.max(one.abs()));
                for (one, other) in zip(&fast[d..], &slow[d..]).step_by(directions.len()) {
                    assert!(
                        (one - other).abs() <= 1e-7 * largest,
                        "{:?}: {one} {other}",
                        directions[d]
                    );
                }
            }
        }
        by_differences(&task, &member, &slow.tangents);
    }
}

/// Compares derivatives with respect to the stiffness of joint 1 with central differences of the
/// plain experiment. No friction event is near the end of a step for these step sizes.
fn by_differences(task: &Task<TwoLink<true>, 2>, member: &Member<'_, 2>, tangents: &[Vec<f64>]) {
    let size = 1e-4 * member.parameters[10];
    let [up, down] = [size, -size].map(|by| {
        let mut parameters = member.parameters.to_vec();
        parameters[10] += by;
        let perturbed = Member {
            parameters: &parameters,
            ..*member
        };
        simulate(task, &perturbed, Width::detect()).expect("finite")
    });
    for quantity in 0..tangents.len() {
        let largest = tangents[quantity].iter().skip(2).step_by(6);
        let largest = largest.fold(0.0f64, |largest, one| largest.max(one.abs()));
        for (k, (up, down)) in zip(&up[quantity], &down[quantity]).enumerate() {
            for i in 0..2 {
                let slope = (up[i] - down[i]) / (2.0 * size);
                let derivative = tangents[quantity][(2 * k + i) * 6 + 2];
                assert!(
                    (slope - derivative).abs() <= 1e-3 * largest,
                    "{k} {i}: {slope} {derivative}"
                );
            }
        }
    }
}
