//! Effects of gears and motors against closed forms.

use crate::common::{
    Draw, LINEAR, RIGID, Run, at_rest, clock, config, differentiate_over_dual_numbers, is_size,
    level, level_joint, scara, sensitivities, simulate, with_effects,
};
use proptest::prelude::*;
use strainwave_core::arm::{OneLink, TwoLink};
use strainwave_core::experiment::{Initial, Member, Quantity, Source, Task};
use strainwave_core::joint::effects::{self, EffectKinds};
use strainwave_core::joint::gear::Law;
use strainwave_core::plant::config::Config;
use strainwave_core::program::Width;

/// Gear ratio.
const N: f64 = 0.01;
/// All effects at once.
const ALL: EffectKinds = EffectKinds::ALL;

fn none() -> EffectKinds {
    EffectKinds::default()
}

fn one_link(gear: Law, effects: EffectKinds) -> Config<OneLink, 1> {
    let mut config = level_joint(gear);
    config.joints[0].effects = effects;
    config
}

/// A link with a very large inertia and no damping: only the motor moves, on the spring of
/// its gear.
fn against_a_wall(effect: &[f64]) -> Vec<f64> {
    let (motor, k) = (1.5e-4, 20e3);
    [
        &[1e12, 0.0, motor, 0.0, 0.0, 0.0, 0.0, k, 0.0, 0.0][..],
        effect,
    ]
    .concat()
}

/// Smallest torque [N m] at which the motor breaks away, in steps of 0.1 %.
fn break_away(gear: Law, effects: EffectKinds, friction: [f64; 2]) -> f64 {
    let spring: &[f64] = if gear.elastic { &[20e3, 5.0, 0.0] } else { &[] };
    let extra: &[f64] = if effects.stribeck {
        &[friction[1], 3.0]
    } else {
        &[]
    };
    let drive = [1.5, 0.0, 1.5e-4, 1e-4, friction[0], 0.0, 0.5];
    let parameters = [&drive[..], spring, extra].concat();
    let level = |k: usize| (friction[0] + friction[1]) * (0.98 + 1e-3 * k as f64);
    (0..40)
        .map(level)
        .find(|torque| {
            let run = Run {
                config: one_link(gear, effects),
                parameters: &parameters,
                voltage: &[[torque / 0.1]],
                steps_per_tick: 1,
                initial: at_rest([0.0]),
                step: 1.25e-4,
                steps: 80,
            };
            run.record(&[Quantity::MotorVelocity])[0][80][0] != 0.0
        })
        .expect("a torque that moves it")
}

#[test]
fn breakaway_torque_is_coulomb_plus_stribeck() {
    let stribeck = EffectKinds {
        stribeck: true,
        ..none()
    };
    for gear in [LINEAR, RIGID] {
        let actual = break_away(gear, stribeck, [0.06, 0.02]);
        assert!((actual - 0.08).abs() < 1.1e-3 * 0.08, "{gear:?} {actual}");
        let plain = break_away(gear, none(), [0.06, 0.0]);
        assert!((plain - 0.06).abs() < 1.1e-3 * 0.06, "{gear:?} {plain}");
        // without Coulomb friction, Stribeck friction alone holds the motor
        let alone = break_away(gear, stribeck, [0.0, 0.02]);
        assert!((alone - 0.02).abs() < 1.1e-3 * 0.02, "{gear:?} {alone}");
    }
}

#[test]
fn sliding_friction_includes_stribeck_friction() {
    let effects = EffectKinds {
        stribeck: true,
        ..none()
    };
    let (viscous, coulomb, more, speed) = (1e-2, 0.06, 0.02, 3.0);
    // enough viscous friction for the total to increase with speed, so that the equilibrium is
    // unique
    let parameters = [1.5, 0.0, 1.5e-4, viscous, coulomb, 0.0, 0.0, more, speed];
    for torque in [0.085, 0.09, 0.12] {
        let run = Run {
            config: one_link(RIGID, effects),
            parameters: &parameters,
            voltage: &[[torque / 0.1]],
            steps_per_tick: 1,
            initial: at_rest([0.0]),
            step: 1.25e-4,
            steps: 16_000,
        };
        let v = run.record(&[Quantity::MotorVelocity])[0][run.steps][0];
        let total = coulomb + more * (-(v / speed) * (v / speed)).exp() + viscous * v;
        assert!(
            (total - torque).abs() < 1e-9 * torque,
            "{torque}: {total} at {v}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 16,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Between two reversals, z(delta) = s - (s - z0) exp(-|delta - delta0| / delta_h).
    #[test]
    fn gear_torque_follows_dahls_loop(largest in 0.5..4.0f64, width in 0.3e-4..5e-4f64, torsion in 0.5e-3..2e-3f64) {
        let effects = EffectKinds { hysteresis: true, ..none() };
        let parameters = against_a_wall(&[largest, width]);
        let run = Run {
            config: one_link(LINEAR, effects),
            parameters: &parameters,
            voltage: &[[0.0]],
            steps_per_tick: 1,
            initial: Initial { link_angle: Some([-torsion]), ..at_rest([0.0]) },
            step: 6.25e-5,
            steps: 6400,
        };
        let record = run.record(&[Quantity::MotorAngle, Quantity::MotorVelocity, Quantity::GearTorque]);
        let delta = |k: usize| N * record[0][k][0] + torsion;
        let z = |k: usize| (record[2][k][0] - 20e3 * delta(k)) / largest;
        let (mut branch, mut reversals) = ((delta(0), z(0)), 0);
        prop_assert!(branch.1.abs() < 1e-12);
        for k in 1..=run.steps {
            let ends = [record[1][k - 1][0], record[1][k][0]];
            if ends[0] * ends[1] < 0.0 {
                // the motion reversed within the step: locate the reversal with a parabola
                let part = ends[0] / (ends[0] - ends[1]);
                let top = delta(k - 1) + 0.5 * N * ends[0] * part * run.step;
                let sign = ends[0].signum();
                let there = sign - (sign - branch.1) * (-(top - branch.0).abs() / width).exp();
                (branch, reversals) = ((top, there), reversals + 1);
            }
            let sign = ends[1].signum();
            let closed = sign - (sign - branch.1) * (-(delta(k) - branch.0).abs() / width).exp();
            // The error of the parabola is h^3 / 12 times the third derivative of the torsion,
            // 1e-10 rad: 3e-6 of the smallest width, for a gear that hysteresis stiffens slightly.
            prop_assert!((z(k) - closed).abs() < 1e-5, "{k}: {} {closed}", z(k));
        }
        prop_assert!(reversals >= 10, "{reversals}");
    }

    #[test]
    fn kinematic_error_acts_on_link_and_motor(
        theta in -30.0..30.0f64, cos in -2e-4..2e-4f64, sin in -2e-4..2e-4f64, k in 1..=4u8
    ) {
        let effects = EffectKinds { kinematic_error: true, ..none() };
        let order = f64::from(k);
        let parameters = against_a_wall(&[cos, sin, order]);
        let (wave_sin, wave_cos) = (order * theta).sin_cos();
        let error = cos * wave_cos + sin * wave_sin;
        let slope = order * (sin * wave_cos - cos * wave_sin);
        let torsion = 1e-3;
        let start = |link: Option<[f64; 1]>| {
            let run = Run {
                config: one_link(LINEAR, effects),
                parameters: &parameters,
                voltage: &[[0.0]],
                steps_per_tick: 1,
                initial: Initial { link_angle: link, ..at_rest([theta]) },
                step: 1e-7,
                steps: 1,
            };
            run.record(&[Quantity::GearTorque, Quantity::MotorVelocity, Quantity::LinkAngle])
        };
        let loaded = start(Some([N * theta + error - torsion]));
        prop_assert!((loaded[0][0][0] - 20e3 * torsion).abs() < 1e-8);
        let acceleration = loaded[1][1][0] / 1e-7;
        let expected = -(N + slope) * 20e3 * torsion / 1.5e-4;
        prop_assert!((acceleration - expected).abs() < 1e-6 * expected.abs());
        // by default the link starts at zero torsion, in equilibrium
        let unloaded = start(None);
        prop_assert!((unloaded[2][0][0] - N * theta - error).abs() < 1e-15);
        prop_assert!(unloaded[1][1][0].abs() < 1e-12);
    }
}

type TwoLinks = (Config<TwoLink<true>, 2>, Vec<f64>);

fn two_links(effects: EffectKinds) -> TwoLinks {
    let mut config = level([LINEAR; 2]);
    config
        .joints
        .iter_mut()
        .for_each(|joint| joint.effects = effects);
    let values = with_effects(&scara(1.0, 0.0), &config);
    (config, values)
}

fn telegraph(seed: u64, ticks: usize) -> Vec<[f64; 2]> {
    let mut draw = Draw::new(seed);
    (0..ticks)
        .map(|_| std::array::from_fn(|_| 8.0 * draw.next().signum()))
        .collect()
}

/// Order of accuracy: slope of the final error over the step size from 0.5 ms to 0.125 ms, averaged
/// over several voltages, because a friction event of one of them may be close to the end of a
/// step.
fn order(arm: &TwoLinks) -> f64 {
    let slopes: Vec<f64> = (1..=8).map(|seed| order_at(arm, seed)).collect();
    println!("{slopes:?}");
    slopes.iter().sum::<f64>() / slopes.len() as f64
}

fn order_at((config, parameters): &TwoLinks, seed: u64) -> f64 {
    let last = |steps_per_tick: usize| {
        let run = Run {
            config: *config,
            parameters,
            voltage: &telegraph(seed, 40),
            steps_per_tick,
            initial: at_rest([0.0; 2]),
            step: 2e-3 / steps_per_tick as f64,
            steps: 40 * steps_per_tick,
        };
        let record = run.record(&[Quantity::MotorVelocity, Quantity::LinkVelocity]);
        [record[0][run.steps], record[1][run.steps]].concat()
    };
    let fine = last(256);
    let error = |steps_per_tick: usize| {
        let actual = last(steps_per_tick);
        let relative = |(a, b): (&f64, &f64)| (a - b).abs() / (1e-3 + b.abs());
        actual.iter().zip(&fine).map(relative).fold(0.0, f64::max)
    };
    let (coarse, finer) = (error(4), error(16));
    (coarse / finer).log2() / 2.0
}

#[test]
fn order_is_four_except_at_hysteresis_reversals() {
    let smooth = EffectKinds {
        hysteresis: false,
        load_friction: false,
        backlash: false,
        drive_lag: false,
        ..ALL
    };
    assert!(
        order(&two_links(smooth)) > 3.7,
        "{}",
        order(&two_links(smooth))
    );
    // The stages of a step resolve a reversal with the accuracy of a stage only: order three.
    let reversals = EffectKinds {
        hysteresis: true,
        ..smooth
    };
    assert!(
        order(&two_links(reversals)) > 2.7,
        "{}",
        order(&two_links(reversals))
    );
}

/// A drive lag acts through the mean voltage of a step.
#[test]
fn order_of_drive_lag_is_two_between_friction_events() {
    let lag = EffectKinds {
        drive_lag: true,
        ..none()
    };
    let (config, mut parameters) = two_links(lag);
    for (value, (name, _)) in parameters.iter_mut().zip(config.parameter_names()) {
        if name == "motor_coulomb_friction" {
            *value = 0.0;
        }
    }
    let actual = order(&(config, parameters));
    assert!((actual - 2.0).abs() < 0.1, "{actual}");
}

#[test]
fn zero_size_effects_do_not_change_the_motion() {
    let plain = scara(1.0, 0.0);
    let (config, with) = two_links(ALL);
    let mut without = with.clone();
    for (k, (name, _)) in config.parameter_names().iter().enumerate() {
        if is_size(name) {
            without[k] = 0.0;
        }
    }
    let run = |config, parameters: &[f64]| {
        let run = Run {
            config,
            parameters,
            voltage: &telegraph(3, 50),
            steps_per_tick: 16,
            initial: at_rest([0.0; 2]),
            step: 1.25e-4,
            steps: 800,
        };
        run.record(&[Quantity::MotorVelocity, Quantity::GearTorque])
    };
    let expected = run(two_links(none()).0, &plain);
    assert_eq!(run(config, &without), expected);
    assert_ne!(run(config, &with), expected);
}

#[test]
fn baseline_program_agrees_with_effects() {
    let (config, parameters) = two_links(ALL);
    let voltage = telegraph(5, 101);
    let reference = vec![[0.0; 2]; 101];
    let task = Task {
        config,
        clock: clock(101),
        servo: None,
        record: vec![Quantity::MotorVelocity],
        link_sensors: Vec::new(),
    };
    let member = Member {
        parameters: &parameters,
        feed_forward: &voltage,
        reference: &reference,
        initial: at_rest([0.0; 2]),
    };
    let [fused, portable] = [Width::detect(), Width::Portable]
        .map(|width| simulate(&task, &member, width).expect("finite").remove(0));
    for (a, b) in fused.as_flattened().iter().zip(portable.as_flattened()) {
        assert!((a - b).abs() < 1e-8 * (1.0 + a.abs())); // rounding, amplified over 0.1 s
    }
}

#[test]
fn invalid_effect_parameters_are_rejected() {
    let (config, values) = two_links(ALL);
    config.check(&values).expect("a possible arm");
    for (name, bad) in [
        ("stribeck_friction", -1e-3),
        ("stribeck_velocity", 0.0),
        ("hysteresis_torque", -1.0),
        ("hysteresis_twist", 0.0),
        ("kinematic_error_cos", f64::NAN),
        ("kinematic_error_order", 0.0),
        ("load_friction", -1e-3),
        ("power_exponent", 0.0),
        ("backlash", -1e-9),
        ("dead_zone", -1e-9),
        ("drive_saturation", -1e-9),
        ("base_compliance", -1e-9),
        ("drive_limit_loss", -1e-9),
        ("drive_limit", 0.0),
        ("drive_lag", -1e-9),
    ] {
        let mut broken = values.clone();
        let names = config.parameter_names();
        let at = names.iter().position(|known| *known == (name, Some(2)));
        broken[at.expect("a known name")] = bad;
        let error = config.check(&broken).expect_err("an impossible arm");
        assert_eq!(error.name, (name, Some(2)));
    }
}

/// Each effect alone: derivatives with respect to its parameters over dual numbers, against central
/// differences of the plain simulation.
#[test]
fn effect_parameter_derivatives_match_differences() {
    for effect in effects::DECLARATIONS {
        let mut kinds = none();
        assert!(kinds.add(effect.name));
        let (config, parameters) = two_links(kinds);
        let voltage = telegraph(11, 60);
        let task = Task {
            config,
            clock: clock(60),
            servo: None,
            record: vec![Quantity::MotorVelocity, Quantity::LinkVelocity],
            link_sensors: Vec::new(),
        };
        let member = Member {
            parameters: &parameters,
            feed_forward: &voltage,
            reference: &voltage,
            initial: at_rest([3.0, -5.0]),
        };
        let names = config.parameter_names();
        let names_of_effect = effect.parameters.iter().map(|parameter| parameter.name);
        for name in names_of_effect {
            let k = names.iter().position(|known| *known == (name, Some(1)));
            let k = k.expect("the joint has it");
            let width = Width::detect();
            let actual = differentiate_over_dual_numbers(&task, &member, &[Source::Parameter(k)]);
            let actual = actual.expect("finite").tangents.remove(0);
            let size = 1e-5 * parameters[k];
            let [up, down] = [size, -size].map(|by| {
                let mut perturbed = parameters.clone();
                perturbed[k] += by;
                let perturbed = Member {
                    parameters: &perturbed,
                    ..member
                };
                let all = simulate(&task, &perturbed, width);
                all.expect("finite")[0].as_flattened().to_vec()
            });
            let largest = actual
                .iter()
                .fold(0.0f64, |largest, one| largest.max(one.abs()));
            assert!(largest * parameters[k].abs() > 1e-6, "{name} does nothing");
            for (derivative, (up, down)) in actual.iter().zip(up.iter().zip(&down)) {
                let slope = (up - down) / (2.0 * size);
                assert!(
                    (derivative - slope).abs() < 1e-3 * largest,
                    "{name}: {derivative} {slope}"
                );
            }
        }
    }
}

/// Derivatives with respect to effect sizes of zero, against one-sided differences.
#[test]
fn zero_size_derivatives_match_one_sided_differences() {
    for effect in effects::DECLARATIONS {
        let mut kinds = none();
        assert!(kinds.add(effect.name));
        let (config, typical) = two_links(kinds);
        let names = config.parameter_names();
        let mut absent = typical.clone();
        for (k, (name, _)) in names.iter().enumerate() {
            if is_size(name) {
                absent[k] = 0.0;
            }
        }
        let voltage = telegraph(11, 60);
        let task = Task {
            config,
            clock: clock(60),
            servo: None,
            record: vec![Quantity::MotorVelocity],
            link_sensors: Vec::new(),
        };
        let member = Member {
            parameters: &absent,
            feed_forward: &voltage,
            reference: &voltage,
            initial: at_rest([3.0, -5.0]),
        };
        let width = Width::detect();
        let run = |member: Member<'_, 2>| {
            let all = simulate(&task, &member, width);
            all.expect("finite")[0].as_flattened().to_vec()
        };
        for size in &effect.parameters[..effect.sizes] {
            let k = names
                .iter()
                .position(|known| *known == (size.name, Some(1)));
            let k = k.expect("the joint has it");
            let direction = [Source::Parameter(k)];
            let actual = sensitivities(&task, &member, &direction, width);
            let actual = actual.expect("finite").tangents.remove(0);
            let by = 1e-3 * typical[k];
            let mut little = absent.clone();
            little[k] = by;
            let perturbed = Member {
                parameters: &little,
                ..member
            };
            let (with, without) = (run(perturbed), run(member));
            let largest = actual
                .iter()
                .fold(0.0f64, |largest, one| largest.max(one.abs()));
            assert!(
                largest * typical[k].abs() > 1e-6,
                "{} does nothing",
                size.name
            );
            for (derivative, (with, without)) in actual.iter().zip(with.iter().zip(&without)) {
                let error = (derivative - (with - without) / by).abs();
                assert!(
                    error < 0.02 * largest,
                    "{}: {error} of {largest}",
                    size.name
                );
            }
        }
    }
}

/// A rigid joint on a ground spring oscillates about the equilibrium of spring and preload.
#[test]
fn ground_spring_oscillates_about_its_equilibrium() {
    let effects = EffectKinds {
        ground_spring: true,
        ..none()
    };
    let (inertia, stiffness, preload) = (0.5, 8.0, -2.0);
    let motor = 1e-4; // times the inverse gear ratio squared, 1e4: 1 kg m^2
    let parameters = [inertia, 0.0, motor, 0.0, 0.0, 0.0, 0.0, stiffness, preload];
    let run = Run {
        config: one_link(RIGID, effects),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: at_rest([0.0]),
        step: 1e-3,
        steps: 2000,
    };
    let record = run.record(&[Quantity::LinkAngle]);
    let omega = (stiffness / (inertia + motor / (N * N))).sqrt();
    for k in 0..=run.steps {
        let expected = 0.25 * (1.0 - (omega * 1e-3 * k as f64).cos());
        assert!((record[0][k][0] - expected).abs() < 1e-9, "{k}");
    }
}

/// An arm without gravity but with `tilt` effects moves as the upright arm.
#[test]
fn tilt_by_a_right_angle_equals_gravity() {
    let tilted = EffectKinds {
        tilt: true,
        ..none()
    };
    for gears in [[LINEAR; 2], [LINEAR, RIGID]] {
        let mut level = crate::common::level(gears);
        for joint in &mut level.joints {
            joint.effects = tilted;
        }
        let upright = config::<TwoLink<true>, 2>(gears);
        let mut values = scara(1.0, 1.0);
        if !gears[1].elastic {
            values.truncate(values.len() - 3);
        }
        let [g1, g2] = [values[3], values[4]];
        let weights = [&values[..13], &[0.0, g1], &values[13..], &[0.0, g2]].concat();
        let voltage = telegraph(5, 50);
        let quantities = [Quantity::LinkAngle, Quantity::GearTorque];
        let expected = Run {
            config: upright,
            parameters: &values,
            voltage: &voltage,
            steps_per_tick: 16,
            initial: at_rest([10.0, 20.0]),
            step: 1.25e-4,
            steps: 800,
        };
        let expected = expected.record(&quantities);
        let actual = Run {
            config: level,
            parameters: &weights,
            voltage: &voltage,
            steps_per_tick: 16,
            initial: at_rest([10.0, 20.0]),
            step: 1.25e-4,
            steps: 800,
        };
        let actual = actual.record(&quantities);
        for (k, scale) in [1.0, 50.0].into_iter().enumerate() {
            let rows = actual[k].as_flattened().iter();
            for (actual, expected) in rows.zip(expected[k].as_flattened()) {
                // rounding, amplified over 0.1 s
                assert!(
                    (actual - expected).abs() < 1e-8 * scale,
                    "{actual} {expected}"
                );
            }
        }
    }
}

/// A rigid joint with a flexible part under a constant torque has one mode in closed form.
#[test]
fn flexible_link_has_its_analytic_mode() {
    let flexible = EffectKinds {
        flexible_link: true,
        ..none()
    };
    let (inertia, part, hz) = (1.5, 0.6, 25.0);
    let motor = 1e-4; // times the inverse gear ratio squared, 1e4: 1 kg m^2
    let parameters = [
        inertia - 1.0,
        0.0,
        motor,
        0.0,
        0.0,
        0.0,
        0.0,
        part,
        hz,
        1e-12,
    ];
    let run = Run {
        config: one_link(RIGID, flexible),
        parameters: &parameters,
        voltage: &[[1.0]],
        steps_per_tick: 1,
        initial: Initial {
            voltage: [1.0],
            ..at_rest([0.0])
        },
        step: 1e-4,
        steps: 4000,
    };
    let record = run.record(&[Quantity::LinkAngle]);
    let omega = std::f64::consts::TAU * hz * (1.0 + part / inertia).sqrt();
    let (acceleration, share) = (10.0 / inertia, part / (inertia + part));
    for k in 0..=run.steps {
        let t = 1e-4 * k as f64;
        let oscillation = 0.5 * t * t - (1.0 - (omega * t).cos()) / (omega * omega);
        let expected = acceleration * (0.5 * t * t - share * oscillation);
        let error = (record[0][k][0] - expected).abs();
        assert!(error < 1e-8, "{k}: {error:e}"); // (w h)^4 times the mode's amplitude of 2e-4 rad
    }
}

/// A stiff flexible part acts as inertia of its link, at both joints.
#[test]
fn stiff_part_adds_inertia_to_its_link() {
    let flexible = EffectKinds {
        flexible_link: true,
        ..none()
    };
    let mut bare = config::<TwoLink<true>, 2>([LINEAR; 2]);
    let plain = bare;
    bare.joints[1].effects = flexible;
    let light = scara(0.0, 0.0);
    let mut heavy = light.clone();
    heavy[1] += 0.1; // beta
    let stiff = [&light[..], &[0.1, 1000.0, 0.3]].concat();
    let motion = |config: Config<TwoLink<true>, 2>, parameters: &[f64]| {
        let run = Run {
            config,
            parameters,
            voltage: &telegraph(5, 50),
            steps_per_tick: 64,
            initial: at_rest([10.0, 20.0]),
            step: 3.125e-5,
            steps: 3200,
        };
        run.record(&[Quantity::LinkAngle]).remove(0)
    };
    let [light, heavy, stiff] = [
        motion(plain, &light),
        motion(plain, &heavy),
        motion(bare, &stiff),
    ];
    for i in 0..2 {
        let max_difference = |one: &[[f64; 2]], other: &[[f64; 2]]| {
            let error = one.iter().zip(other).map(|(a, b)| (a[i] - b[i]).abs());
            error.fold(0.0, f64::max)
        };
        // the squared frequency of the gears' modes, 30 Hz, is a few thousandths of the part's
        assert!(
            max_difference(&stiff, &heavy) < 0.01 * max_difference(&light, &heavy),
            "{i}"
        );
    }
}

/// A link on its gear, with the motor at rest, oscillates with its base: two modes in closed form,
/// starting with the base in equilibrium with the gear torque.
#[test]
fn soft_base_has_its_analytic_modes() {
    let soft = EffectKinds {
        soft_base: true,
        ..none()
    };
    let (link, k, compliance, hz) = (1.5, 20e3, 2e-5, 40.0);
    let drive = [link, 0.0, 1e12, 0.0, 0.0, 0.0, 0.0];
    let parameters = [&drive[..], &[k, 0.0, 0.0, compliance, hz, 1e-12]].concat();
    let begin = 1e-3;
    let run = Run {
        config: one_link(LINEAR, soft),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: Initial {
            link_angle: Some([begin]),
            ..at_rest([0.0])
        },
        step: 1e-4,
        steps: 4000,
    };
    let record = run.record(&[Quantity::LinkAngle, Quantity::GearTorque]);
    // angles of link and base, scaled by the roots of their inertias, obey x'' = -[[a, b], [b, d]]
    // x
    let base = 1.0 / (compliance * (std::f64::consts::TAU * hz).powi(2));
    let (a, b) = (k / link, -k / (link * base).sqrt());
    let d = (k + 1.0 / compliance) / base;
    let (mean, half_difference) = (0.5 * (a + d), (0.25 * (a - d).powi(2) + b * b).sqrt());
    let (slow, fast) = (mean - half_difference, mean + half_difference);
    let torque = -begin / (1.0 / k + compliance);
    let scaled = [link.sqrt() * begin, -base.sqrt() * compliance * torque];
    let of_slow = [
        ((fast - a) * scaled[0] - b * scaled[1]) / (fast - slow),
        ((fast - d) * scaled[1] - b * scaled[0]) / (fast - slow),
    ];
    for step in 0..=run.steps {
        let t = 1e-4 * step as f64;
        let [one, other] = [slow, fast].map(|square| (square.sqrt() * t).cos());
        let x = [0, 1].map(|i| of_slow[i] * (one - other) + scaled[i] * other);
        let [psi, phi] = [x[0] / link.sqrt(), x[1] / base.sqrt()];
        // error (w h)^4 over 0.4 s at 60 Hz
        assert!((record[0][step][0] - psi).abs() < 1e-6 * begin, "{step}");
        let torque = k * (phi - psi);
        assert!((record[1][step][0] - torque).abs() < 1e-5, "{step}");
    }
}

/// A light base acts as compliance of the gear, at rest and in motion.
#[test]
fn light_base_adds_compliance_to_its_gear() {
    let soft = EffectKinds {
        soft_base: true,
        ..none()
    };
    let plain = config::<TwoLink<true>, 2>([LINEAR; 2]);
    let mut standing = plain;
    standing.joints[0].effects = soft;
    let mut stiff = scara(0.0, 1.0);
    stiff[11] = 2.0; // gear_damping: small, so that both dampings add to first order
    let compliance = 1e-5;
    let mut softer = stiff.clone();
    softer[10] = 1.0 / (1.0 / stiff[10] + compliance);
    // the torsion rate is divided between gear and base
    let (hz, damping) = (1500.0, 0.5);
    let of_base = 2.0 * damping / (std::f64::consts::TAU * hz * compliance);
    let share = softer[10] / stiff[10];
    softer[11] = share * share * stiff[11] + (1.0 - share).powi(2) * of_base;
    let light = [&stiff[..13], &[compliance, hz, damping], &stiff[13..]].concat();
    let motion = |config: Config<TwoLink<true>, 2>, parameters: &[f64]| {
        let run = Run {
            config,
            parameters,
            voltage: &telegraph(5, 50),
            steps_per_tick: 64,
            initial: at_rest([10.0, 20.0]),
            step: 3.125e-5,
            steps: 3200,
        };
        run.record(&[Quantity::LinkAngle]).remove(0)
    };
    let [stiff, softer, light] = [
        motion(plain, &stiff),
        motion(plain, &softer),
        motion(standing, &light),
    ];
    assert!((light[0][0] - softer[0][0]).abs() < 1e-12);
    let max_difference = |one: &[[f64; 2]], other: &[[f64; 2]]| {
        let error = one.iter().zip(other).map(|(a, b)| (a[0] - b[0]).abs());
        error.fold(0.0, f64::max)
    };
    assert!(max_difference(&light, &softer) < 0.01 * max_difference(&stiff, &softer));
}

/// Motor torque [N m] at voltages commanded in succession, with one effect of the drive and a
/// torque of 0.1 N m per volt.
fn drive_torques<const K: usize>(name: &str, values: &[f64], voltage: [f64; K]) -> [f64; K] {
    let mut effects = none();
    assert!(effects.add(name));
    let parameters = [&[0.5, 0.0, 1e-4, 0.0, 0.0, 0.0, 0.0][..], values].concat();
    let run = Run {
        config: one_link(RIGID, effects),
        parameters: &parameters,
        voltage: &voltage.map(|volts| [volts]),
        steps_per_tick: 1,
        initial: Initial {
            voltage: [voltage[0]],
            ..at_rest([0.0])
        },
        step: 1e-3,
        steps: K - 1,
    };
    let record = run.record(&[Quantity::MotorTorque]);
    std::array::from_fn(|k| record[0][k][0])
}

#[test]
fn drive_effects_scale_the_voltage() {
    let voltage = [10.0, 0.0, 0.2, -0.2, -10.0];
    for (name, values, expected) in [
        ("dead-zone", &[0.5][..], [0.95, 0.0, 0.0, 0.0, -0.95]),
        ("drive-gain", &[-0.1], [0.9, 0.0, 0.018, -0.018, -0.9]),
        (
            "drive-saturation",
            &[0.01],
            [0.9, 0.0, 0.01996, -0.01996, -0.9],
        ),
        ("drive-limit", &[0.5, 6.0], [0.8, 0.0, 0.02, -0.02, -0.8]),
        ("drive-limit", &[1.0, 6.0], [0.6, 0.0, 0.02, -0.02, -0.6]),
    ] {
        for (actual, expected) in drive_torques(name, values, voltage).iter().zip(expected) {
            assert!((actual - expected).abs() < 1e-15, "{name}: {actual}");
        }
    }
}

/// The motion does not depend on how often a constant voltage is commanded.
#[test]
fn drive_lag_is_independent_of_tick_length() {
    let lag = EffectKinds {
        drive_lag: true,
        ..none()
    };
    let (config, parameters) = two_links(lag);
    let run = |steps_per_tick: usize| {
        let voltage = telegraph(3, 10);
        let repeat = 16 / steps_per_tick;
        let voltage: Vec<[f64; 2]> = voltage.iter().flat_map(|row| vec![*row; repeat]).collect();
        let run = Run {
            config,
            parameters: &parameters,
            voltage: &voltage,
            steps_per_tick,
            initial: at_rest([0.0; 2]),
            step: 1.25e-4,
            steps: 160,
        };
        run.record(&[Quantity::MotorVelocity])
    };
    assert_eq!(run(16), run(4));
}

/// With a lag of one tick, 1/e remains of each step of the voltage at the end of the tick, and 1 -
/// 1/e of it on average.
#[test]
fn drive_lag_has_its_analytic_mean() {
    let voltage = [10.0, 0.0, 0.2, -0.2, -10.0];
    let decay = (-1.0f64).exp();
    let mut state = voltage[0];
    for (actual, voltage) in drive_torques("drive-lag", &[1e-3], voltage)
        .iter()
        .zip(voltage)
    {
        let mean = voltage + (1.0 - decay) * (state - voltage);
        assert!((actual - 0.1 * mean).abs() < 1e-15, "{voltage}: {actual}");
        state = voltage + decay * (state - voltage);
    }
}

/// Within its dead band a gear transmits only the torque of its damping.
#[test]
fn backlash_transmits_no_torque_in_its_dead_band() {
    let effects = EffectKinds {
        backlash: true,
        ..none()
    };
    let (half, stiffness) = (2e-4, 20e3);
    let parameters = [
        1e12, 0.0, 1.5e-4, 0.0, 0.0, 0.0, 0.0, stiffness, 0.0, 0.0, half,
    ];
    let run = Run {
        config: one_link(LINEAR, effects),
        parameters: &parameters,
        voltage: &[[3.0]],
        steps_per_tick: 1,
        initial: at_rest([0.0]),
        step: 1.25e-4,
        steps: 400,
    };
    let record = run.record(&[
        Quantity::MotorAngle,
        Quantity::GearTorque,
        Quantity::LinkAngle,
    ]);
    let (mut within, mut beyond) = (0, 0);
    for k in 0..=run.steps {
        let torsion = N * record[0][k][0] - record[2][k][0];
        let strain = (torsion.abs() - half).max(0.0).copysign(torsion);
        assert!((record[1][k][0] - stiffness * strain).abs() < 1e-9);
        within += i32::from(strain == 0.0);
        beyond += i32::from(strain != 0.0);
    }
    assert!(within > 5 && beyond > 5);
}

/// Break-away torque of a loaded motor with load-dependent friction.
#[test]
fn load_friction_holds_the_motor() {
    let effects = EffectKinds {
        load_friction: true,
        ..none()
    };
    // torsion 0.02 rad motor side of a gear with 20 kN m/rad: 4 N m at the link, 0.04 N m at the
    // motor
    let parameters = [1e12, 0.0, 1.5e-4, 0.0, 0.01, 0.0, 0.0, 20e3, 0.0, 0.0, 0.5];
    let breaks = |torque: f64| {
        let mut initial = at_rest([0.02]);
        initial.link_angle = Some([0.0]);
        let run = Run {
            config: one_link(LINEAR, effects),
            parameters: &parameters,
            voltage: &[[torque / 0.1]],
            steps_per_tick: 1,
            initial,
            step: 1.25e-4,
            steps: 4,
        };
        run.record(&[Quantity::MotorVelocity])[0][4][0] > 0.0
    };
    let largest = 0.04 + 0.01 + 0.5 * 0.04;
    assert!(breaks(1.001 * largest) && !breaks(0.999 * largest));
}
