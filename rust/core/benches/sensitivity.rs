//! Nanoseconds per integrator step on one core: one arm with derivatives, beside the same arm without.

use std::marker::PhantomData;
use std::time::Instant;

use strainwave_core::arm::TwoLink;
use strainwave_core::config::{Config, GearKind, JointConfig};
use strainwave_core::dispatch::{Width, sensitivities, simulate};
use strainwave_core::gear::CORNER;
use strainwave_core::simulate::{Clock, Initial, Member, Quantity, Source, Task};

/// Short, so that among many runs some are left alone by whatever else the machine does.
const STEPS: usize = 2400;

/// The built-in SCARA-type arm with 5 kg at its tip.
const PARAMETERS: [f64; 29] = [
    1.6097, 0.64425, 0.7875, 0.0, 0.0, //
    1.5e-4, 2e-4, 0.06, 0.0, 0.5, 16e3, 25e3, 29e3, 7.0, 25.0, 20.0, 0.0, //
    0.5e-4, 0.8e-4, 0.03, 0.0, 0.15, 4.7e3, 6.1e3, 7.1e3, 2.0, 6.9, 4.0, 0.0,
];

fn task(record: Vec<Quantity>) -> Task<TwoLink<false>, 2> {
    let joint = |torque_per_volt, accelerometer_distance| JointConfig {
        gear: GearKind::ThreeSlope,
        ratio: 0.01,
        torque_per_volt,
        current_loop_hz: Some(1000.0),
        encoder_counts: Some(8192.0),
        accelerometer_distance,
        accelerometer_hz: Some(300.0),
        gyro_hz: Some(5.0),
    };
    Task {
        config: Config {
            arm: PhantomData,
            link_length: 0.35,
            gravity: 0.0,
            corner: CORNER,
            joints: [joint(0.08, 0.33), joint(0.03, 0.27)],
        },
        clock: Clock {
            step: 1.25e-4,
            steps_per_tick: 8,
            steps_per_servo: 8,
            steps_per_sample: 8,
            samples: STEPS / 8 + 1,
        },
        servo: None,
        record,
    }
}

fn main() {
    // Random telegraph voltage of +-10 V on joint 1; joint 2 swings free.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let voltage: Vec<[f64; 2]> = (0..=STEPS / 8)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            [if state >> 63 == 0 { 10.0 } else { -10.0 }, 0.0]
        })
        .collect();
    let reference = vec![[0.0; 2]; voltage.len()];
    let member = Member {
        parameters: &PARAMETERS,
        feed_forward: &voltage,
        reference: &reference,
        initial: Initial {
            motor_angle: [0.0; 2],
            motor_velocity: [0.0; 2],
            link_angle: None,
            link_velocity: [0.0; 2],
            voltage: [0.0; 2],
        },
    };
    let plain = task(vec![Quantity::MotorVelocity]);
    let sensed = task(vec![Quantity::MotorVelocity, Quantity::Accelerometer]);
    // The gravity torques of a horizontal arm change nothing.
    let all: Vec<Source> = (0..PARAMETERS.len())
        .filter(|k| !(3..5).contains(k))
        .map(Source::Parameter)
        .collect();
    for (name, task) in [("two links", &plain), ("with sensors", &sensed)] {
        for width in [Width::Portable, Width::Avx2, Width::Avx512] {
            if width > Width::detect() {
                continue;
            }
            let mut best = [f64::INFINITY; 3];
            for _ in 0..400 {
                let begin = Instant::now();
                assert!(simulate(task, &[member], width)[0].is_ok());
                best[0] = best[0].min(begin.elapsed().as_secs_f64());
                for (best, directions) in best[1..].iter_mut().zip([&all[..15], &all]) {
                    let begin = Instant::now();
                    assert!(sensitivities(task, &member, directions, width).is_ok());
                    *best = best.min(begin.elapsed().as_secs_f64());
                }
            }
            let steps = STEPS as f64;
            let [plain, few, many] = best.map(|time| time / steps * 1e9);
            println!(
                "{name}, {width:?}: {plain:.1} ns a step; with 15 derivatives {few:.1}, \
                 {:.2} times; with 25 {many:.1}, {:.2} times",
                few / plain,
                many / plain
            );
        }
    }
}
