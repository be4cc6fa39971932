//! Identities of every arm: energy balance, order of accuracy, and equal results at every register
//! width.

use crate::common::{
    BuiltIn, Draw, LINEAR, RIGID, Run, at_rest, config, level, scara, simulate, with_effects,
};
use proptest::prelude::*;
use strainwave_arms::WithPrograms;
use strainwave_core::actuation::current_loop::StepTorque;
use strainwave_core::arm::{Arm, OneLink, TwoLink};
use strainwave_core::experiment::{Clock, Member, Quantity, Task};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::AllLaws;
use strainwave_core::plant::config::Config;
use strainwave_core::plant::rigid::inverse_dynamics;
use strainwave_core::plant::{Modes, Plant, State};
use strainwave_core::program::Width;

/// Quantities of the state of motors and links.
const STATE: [Quantity; 4] = [
    Quantity::MotorAngle,
    Quantity::MotorVelocity,
    Quantity::LinkAngle,
    Quantity::LinkVelocity,
];

fn telegraph<const N: usize>(seed: u64, ticks: usize, volts: f64) -> Vec<[f64; N]> {
    let mut draw = Draw::new(seed);
    (0..ticks)
        .map(|_| std::array::from_fn(|_| if draw.next() < 0.0 { -volts } else { volts }))
        .collect()
}

/// Largest relative difference of the final states for two step sizes.
fn distance<A: WithPrograms<2>>(
    config: Config<A, 2>,
    parameters: &[f64],
    coarse: usize,
    fine: usize,
) -> f64 {
    let voltage = telegraph::<2>(7, 40, 8.0);
    let last = |steps_per_tick: usize| {
        let run = Run {
            config,
            parameters,
            voltage: &voltage,
            steps_per_tick,
            initial: at_rest([0.0; 2]),
            step: 2e-3 / steps_per_tick as f64,
            steps: 40 * steps_per_tick,
        };
        run.record(&STATE).last_row()
    };
    let (a, b) = (last(coarse), last(fine));
    a.iter()
        .zip(&b)
        .map(|(a, b)| (a - b).abs() / (1e-3 + b.abs()))
        .fold(0.0, f64::max)
}

trait LastRow {
    fn last_row(&self) -> Vec<f64>;
}

impl<const N: usize> LastRow for Vec<Vec<[f64; N]>> {
    fn last_row(&self) -> Vec<f64> {
        self.iter()
            .flat_map(|column| *column.last().unwrap())
            .collect()
    }
}

/// Order of accuracy: slope of the error over the step size, from 0.5 ms to 0.125 ms.
fn order<A: WithPrograms<2>>(config: Config<A, 2>, parameters: &[f64]) -> f64 {
    let fine = 256;
    let coarse = distance(config, parameters, 4, fine);
    let finer = distance(config, parameters, 16, fine);
    println!("errors {coarse:e} {finer:e}");
    (coarse / finer).log2() / 2.0
}

#[test]
fn order_is_four_without_sticking() {
    let level = order(level([LINEAR; 2]), &scara(0.0, 0.0));
    let upright = order(config::<TwoLink<true>, 2>([LINEAR; 2]), &scara(0.0, 1.0));
    assert!(level > 3.8 && upright > 3.8, "{level} {upright}");
}

#[test]
fn order_is_four_with_sticking_and_slipping() {
    let config = level([LINEAR; 2]);
    let parameters = scara(1.0, 0.0);
    let actual = order(config, &parameters);
    assert!(actual > 3.7, "{actual}");
    let mut settling = parameters.clone();
    settling[12] = 3e-4;
    settling[20] = 1e-3;
    let actual = order(config, &settling);
    assert!(actual > 3.7, "{actual}");
    // the case contains sticking and sliding
    let voltage = telegraph::<2>(7, 40, 8.0);
    let run = Run {
        config,
        parameters: &parameters,
        voltage: &voltage,
        steps_per_tick: 16,
        initial: at_rest([0.0; 2]),
        step: 1.25e-4,
        steps: 640,
    };
    let sliding = &run.record(&[Quantity::Sliding])[0];
    let turns = (0..2)
        .map(|i| {
            sliding
                .windows(2)
                .filter(|pair| pair[0][i] != pair[1][i])
                .count()
        })
        .sum::<usize>();
    assert!(turns >= 4, "{turns}");
}

#[test]
fn short_settling_time_converges_to_instant_stop() {
    let last = |time: f64| {
        let mut parameters = scara(1.0, 0.0);
        (parameters[12], parameters[20]) = (time, time);
        let run = Run {
            config: level([LINEAR; 2]),
            parameters: &parameters,
            voltage: &telegraph::<2>(7, 40, 8.0),
            steps_per_tick: 16,
            initial: at_rest([0.0; 2]),
            step: 1.25e-4,
            steps: 640,
        };
        run.record(&[Quantity::LinkAngle])[0][640]
    };
    let stops_instantly = last(0.0);
    let difference = |time: f64| (last(time)[0] - stops_instantly[0]).abs();
    let (near, nearer) = (difference(1e-5), difference(1e-6));
    assert!(nearer < 0.15 * near, "{near} {nearer}"); // first order in the settling time
    assert!(near < 1e-3 * stops_instantly[0].abs(), "{near}");
}

#[test]
fn torque_jumps_reverse_settling_motors_within_a_step() {
    // Without a current loop the torque jumps with the voltage. A sliding motor may be pushed in
    // the other direction beyond the friction limit at the start of a step. The torques of this
    // test cause at most 3000 rad/s^2 at motor 1 and 9000 rad/s^2 at motor 2.
    let mut config = level([LINEAR; 2]);
    config.joints[0].torque_per_volt = 0.08;
    config.joints[1].torque_per_volt = 0.03;
    for seed in 0..40 {
        let mut parameters = scara(1.0, 0.0);
        (parameters[12], parameters[20]) = (3e-3, 3e-3);
        let run = Run {
            config,
            parameters: &parameters,
            voltage: &telegraph::<2>(seed, 200, 3.0),
            steps_per_tick: 8,
            initial: at_rest([0.0; 2]),
            step: 1.25e-4,
            steps: 1600,
        };
        for pair in run.record(&[Quantity::MotorVelocity])[0].windows(2) {
            let change = [0, 1].map(|i| (pair[1][i] - pair[0][i]).abs() / 1.25e-4);
            assert!(change[0] < 5e3 && change[1] < 1.5e4, "{seed} {change:?}");
        }
    }
}

/// Relative error of the energy balance: final energy = initial energy + work of the motors -
/// dissipation, over a run sampled every step.
fn energy_error<A: WithPrograms<N>, const N: usize>(run: &Run<'_, A, N>) -> f64 {
    let mut quantities = STATE.to_vec();
    quantities.extend([
        Quantity::MotorTorque,
        Quantity::Sliding,
        Quantity::GearTorque,
    ]);
    let record = run.record(&quantities);
    let plant: Plant<A, f64, AllLaws, N, true> = run.config.plant(run.parameters);
    let state = |k: usize| {
        let mut x = State {
            motor_angle: record[0][k],
            motor_velocity: record[1][k],
            link_angle: record[2][k],
            link_velocity: record[3][k],
            hysteresis: [0.0; N],
            part_angle: [0.0; N],
            part_velocity: [0.0; N],
            base_torque: [0.0; N],
            base_torque_rate: [0.0; N],
        };
        let without = plant.gear_torques(&x);
        for i in 0..N {
            if let Some(hysteresis) = &plant.joints[i].effects.hysteresis {
                x.hysteresis[i] = (record[6][k][i] - without[i]) / hysteresis.torque;
            }
        }
        x
    };
    let power = |k: usize| {
        let x = state(k);
        let modes = Modes {
            direction: record[5][k],
            free: [1.0; N],
        };
        let work: f64 = (0..N).map(|i| record[4][k][i] * x.motor_velocity[i]).sum();
        work - plant.dissipation(&x, &modes)
    };
    let mut balance = 0.0;
    let mut turnover = 0.0;
    for k in (0..run.steps).step_by(2) {
        let part = run.step / 3.0 * (power(k) + 4.0 * power(k + 1) + power(k + 2));
        balance += part;
        turnover += part.abs();
    }
    let gained = plant.energy(&state(run.steps)) - plant.energy(&state(0));
    (gained - balance).abs() / turnover
}

fn random_two_link() -> impl Strategy<Value = (Vec<f64>, u64)> {
    let factor = || 0.5..2.0f64;
    (prop::collection::vec(factor(), 21), any::<u64>()).prop_map(|(factors, seed)| {
        let mut values: Vec<f64> = scara(1.0, 1.0)
            .iter()
            .zip(&factors)
            .map(|(v, f)| v * f)
            .collect();
        // limit gamma to the range allowed by alpha and beta
        values[2] = values[2].min(0.8 * (values[0] * values[1]).sqrt());
        (values, seed)
    })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 24,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn energy_balance_holds_without_coulomb_friction((mut values, seed) in random_two_link()) {
        for joint in [5, 13] {
            values[joint + 2] = 0.0; // no Coulomb friction, so the power has no kinks
        }
        let voltage = telegraph::<2>(seed, 1, 6.0);
        let run = Run {
            config: config::<TwoLink<true>, 2>([LINEAR; 2]),
            parameters: &values, voltage: &voltage, steps_per_tick: 1,
            initial: at_rest([10.0, 20.0]), step: 1.25e-4, steps: 1600,
        };
        let error = energy_error(&run);
        prop_assert!(error < 1e-6, "{}", error);
    }

    #[test]
    fn energy_balance_holds_with_sticking_and_slipping((values, seed) in random_two_link()) {
        let voltage = telegraph::<2>(seed, 100, 6.0);
        for gears in [[LINEAR; 2], [RIGID, LINEAR]] {
            let values = match gears[0].elastic {
                false => [&values[..10], &values[13..]].concat(),
                true => values.clone(),
            };
            let run = Run {
                config: config::<TwoLink<true>, 2>(gears),
                parameters: &values, voltage: &voltage, steps_per_tick: 64,
                initial: at_rest([10.0, 20.0]), step: 1.25e-4 / 4.0, steps: 6400,
            };
            // Simpson's rule resolves kinks of the friction power and jumps of an ideal current
            // loop at sampled instants only, so the step is short.
            let error = energy_error(&run);
            prop_assert!(error < 0.02, "{:?} {}", gears, error);
        }
    }

    #[test]
    fn energy_balance_holds_with_every_effect((mut values, seed) in random_two_link(), few in any::<bool>()) {
        // Without hysteresis the power is smooth except for friction jumps; the kinematic error
        // must neither add nor remove energy.
        let mut config = config::<TwoLink<true>, 2>([LINEAR; 2]);
        for (i, joint) in config.joints.iter_mut().enumerate() {
            joint.effects = EffectKinds::ALL;
            joint.effects.stribeck = !few;
            joint.effects.hysteresis = !few;
            joint.effects.load_friction = !few;
            joint.effects.backlash = !few;
            joint.effects.drive_lag = !few; // its torque is piecewise constant
            // recordings do not contain the motion of the flexible part or the base
            joint.effects.flexible_link = false;
            joint.effects.soft_base = false;
            values[5 + 8 * i + 2] *= f64::from(u8::from(!few));
        }
        let values = with_effects(&values, &config);
        let voltage = telegraph::<2>(seed, if few { 1 } else { 100 }, 6.0);
        let run = Run {
            config, parameters: &values, voltage: &voltage, steps_per_tick: 64,
            initial: at_rest([10.0, 20.0]), step: 1.25e-4 / 4.0, steps: 6400,
        };
        let error = energy_error(&run);
        prop_assert!(error < if few { 1e-6 } else { 0.02 }, "{}", error);
    }

    /// A free arm on soft bases with flexible links: all energy is dissipated in the dampers.
    #[test]
    fn energy_balance_holds_with_flexible_links_and_soft_bases((mut values, seed) in random_two_link()) {
        let mut config = config::<TwoLink<true>, 2>([LINEAR; 2]);
        for (i, joint) in config.joints.iter_mut().enumerate() {
            joint.effects.flexible_link = true;
            joint.effects.soft_base = true;
            values[5 + 8 * i + 2] = 0.0; // no Coulomb friction
        }
        let values = with_effects(&values, &config);
        let plant: Plant<TwoLink<true>, f64, AllLaws, 2, true> = config.plant(&values);
        let mut draw = Draw::new(seed);
        let mut some = |size: f64| std::array::from_fn(|_| size * draw.next());
        let mut x = State {
            motor_angle: some(20.0),
            motor_velocity: some(20.0),
            link_angle: some(0.2),
            link_velocity: some(0.5),
            hysteresis: [0.0; 2],
            part_angle: some(0.2),
            part_velocity: some(0.5),
            base_torque: some(50.0),
            base_torque_rate: some(5e3),
        };
        let none = [0.0; 2];
        let modes = Modes { direction: none, free: [1.0; 2] };
        let torque = StepTorque { begin: none, middle: none, end: none };
        let (step, begun) = (6.25e-5, plant.energy(&x));
        let (mut lost, mut before) = (0.0, plant.dissipation(&x, &modes));
        for k in 1..=3200 {
            let now = plant.instant(&x, &none, &modes);
            x = plant.runge_kutta(&x, &now, &torque, &modes, step, &mut ());
            let power = plant.dissipation(&x, &modes);
            // Simpson's rule over pairs of steps: weight 4/3 in the middle, 1/3 at each end
            lost += step / 3.0 * if k % 2 == 1 { before + 4.0 * power } else { power };
            before = power;
        }
        let error = (plant.energy(&x) + lost - begun).abs() / lost;
        prop_assert!(error < 1e-6, "{}", error);
    }

    #[test]
    fn inertia_matrix_is_positive_definite((values, _) in random_two_link(), q in -4.0..4.0f64) {
        let arm = TwoLink::<true>::built_in(2);
        let m = arm.inertia(&arm.base(&values[..5]), &arm.posture(&[0.0, q]));
        prop_assert!(m[0][0] > 0.0 && m[0][0] * m[1][1] > m[0][1] * m[1][0]);
        prop_assert_eq!(m[0][1], m[1][0]);
    }

    #[test]
    fn regressor_times_parameters_is_inverse_dynamics(
        (values, _) in random_two_link(),
        q in prop::array::uniform2(-3.0..3.0f64),
        dq in prop::array::uniform2(-3.0..3.0f64),
        ddq in prop::array::uniform2(-9.0..9.0f64),
    ) {
        let config = config::<TwoLink<true>, 2>([LINEAR; 2]);
        let torque = inverse_dynamics(&config.plant(&values), &q, &dq, &ddq);
        let columns = config.arm.regressor(&config.arm.posture(&q), &dq, &ddq);
        for i in 0..2 {
            let joint_values = &values[5 + 8 * i..];
            let body: f64 = columns.as_ref().iter().zip(&values).map(|(column, v)| column[i] * v).sum();
            let speed = dq[i] / 0.01;
            let friction = joint_values[1] * speed + joint_values[2] * dq[i].signum() + joint_values[3];
            let expected = 0.01 * (body + joint_values[4] * dq[i]) + joint_values[0] * ddq[i] / 0.01 + friction;
            prop_assert!((torque[i] - expected).abs() < 1e-12 * (1.0 + expected.abs()));
        }
    }

    #[test]
    fn all_register_widths_agree(seed in any::<u64>()) {
        let mut draw = Draw::new(seed);
        let values: Vec<f64> = scara(1.0, 0.0).iter().map(|v| v * (1.0 + 0.1 * draw.next())).collect();
        let voltage = telegraph::<2>(seed, 101, 8.0);
        let reference = vec![[0.0; 2]; 101];
        let task = Task {
            config: level([LINEAR; 2]),
            clock: Clock { step: 1.25e-4, steps_per_tick: 8, steps_per_servo: 8, steps_per_sample: 8, samples: 101 },
            servo: None,
            record: STATE.to_vec(),
            link_sensors: Vec::new(),
        };
        let member = Member {
            parameters: &values, feed_forward: &voltage, reference: &reference, initial: at_rest([0.0; 2]),
        };
        let [portable, fused] = [Width::Portable, Width::detect()]
            .map(|width| simulate(&task, &member, width).expect("finite").last_row());
        for (a, b) in portable.iter().zip(&fused) {
            // Rounding differs (fused or not) and is amplified little over 0.1 s.
            prop_assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()));
        }
    }

    #[test]
    fn motion_stays_finite(
        factors in prop::collection::vec(-1.0..1.0f64, 21), seed in any::<u64>(),
        kinds in prop::array::uniform2(0usize..2), volts in 0.0..20.0f64,
    ) {
        // Parameters are within a factor of ten of typical values; friction is up to a hundred
        // times larger.
        let mut values: Vec<f64> = scara(1.0, 1.0).iter().zip(&factors).map(|(v, f)| v * 10f64.powf(*f)).collect();
        values[2] = values[2].min(0.9 * (values[0] * values[1]).sqrt());
        for joint in [5, 13] {
            values[joint + 2] *= 10f64.powf(1.0 - factors[joint].abs());
            values[joint + 3] = 0.02 * factors[joint + 3];
            values[joint + 7] = (1e-3 * factors[joint + 7]).max(0.0);
        }
        let gears = kinds.map(|kind| [LINEAR, RIGID][kind]);
        let mut chosen = values[..5].to_vec();
        for (i, gear) in gears.iter().enumerate() {
            let joint_values = &values[5 + 8 * i..13 + 8 * i];
            chosen.extend(if *gear == RIGID { &joint_values[..5] } else { joint_values });
        }
        let voltage = telegraph::<2>(seed, 60, volts);
        let run = Run {
            config: config::<TwoLink<true>, 2>(gears), parameters: &chosen, voltage: &voltage,
            steps_per_tick: 8, initial: at_rest([5.0, -30.0]), step: 1.25e-4, steps: 480,
        };
        let record = run.record(&STATE);
        prop_assert!(record.iter().flatten().flatten().all(|x| x.is_finite()));
    }
}

#[test]
fn rigid_arm_motion_agrees_with_inverse_dynamics() {
    let linear = scara(1.0, 1.0);
    let parameters = [&linear[..10], &linear[13..18]].concat();
    let voltage = telegraph::<2>(3, 50, 9.0);
    let config = config::<TwoLink<true>, 2>([RIGID; 2]);
    let run = Run {
        config,
        parameters: &parameters,
        voltage: &voltage,
        steps_per_tick: 16,
        initial: at_rest([0.0, 30.0]),
        step: 1.25e-4,
        steps: 800,
    };
    let record = run.record(&[
        Quantity::LinkAngle,
        Quantity::LinkVelocity,
        Quantity::LinkAcceleration,
        Quantity::MotorTorque,
    ]);
    let plant = config.plant(&parameters);
    for k in 0..=run.steps {
        let torque = inverse_dynamics(&plant, &record[0][k], &record[1][k], &record[2][k]);
        for i in 0..2 {
            if record[1][k][i] != 0.0 {
                assert!((torque[i] - record[3][k][i]).abs() < 1e-11);
            }
        }
    }
}

#[test]
fn friction_holds_arm_against_gravity() {
    // A link in a vertical plane whose gravity torque, 0.3 N m at the motor, is below the friction
    // limit.
    let parameters = [1.0, 30.0, 1.5e-4, 1e-4, 0.5, 0.0, 0.1, 20e3, 5.0, 0.0];
    let run = Run {
        config: config::<OneLink, 1>([LINEAR]),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: at_rest([0.0]),
        step: 1.25e-4,
        steps: 8000,
    };
    let record = run.record(&STATE);
    for k in 0..=run.steps {
        assert_eq!((record[0][k][0], record[1][k][0]), (0.0, 0.0));
        assert!(record[3][k][0].abs() < 1e-12); // the link is at rest on its spring
    }
    let sag = -record[2][0][0];
    assert!((sag * 20e3 - 30.0 * sag.cos()).abs() < 1e-10);
}
