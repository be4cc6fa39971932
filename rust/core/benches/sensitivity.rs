//! Nanoseconds per integrator step on one core: one arm with derivatives, beside the same arm without.

mod common;

use std::time::Instant;

use common::{member, task, telegraph, widths};
use strainwave_core::dispatch::{sensitivities, simulate};
use strainwave_core::experiment::{Member, Quantity, Source};
use strainwave_core::sensors::decimation::Decimation;

/// A second: short, so that among many runs some are left alone by whatever else the machine does.
const STEPS: usize = 8000;

/// Motors that take so long to stop [s], where they do not stop at once.
const SETTLING: f64 = 1.25e-4;

/// So much memory [bytes], freed once, makes glibc keep what is freed later, as `identify` tells it
/// to: else the kernel clears the results' pages anew in each run.
const FREED: usize = 31 << 20;

fn main() {
    drop(std::hint::black_box(vec![1_u8; FREED]));
    let voltage = telegraph(STEPS);
    let at_once = member(&voltage);
    let names = task(STEPS, Vec::new()).config.parameter_names();
    let mut slow = at_once.parameters.to_vec();
    for (value, (name, _)) in slow.iter_mut().zip(&names) {
        if *name == "friction_settling_time" {
            *value = SETTLING;
        }
    }
    let settling = Member {
        parameters: &slow,
        ..at_once
    };
    let plain = task(STEPS, vec![Quantity::MotorVelocity]);
    let sensors = vec![Quantity::MotorVelocity, Quantity::Accelerometer];
    let sensed = task(STEPS, sensors);
    let mut every_step = sensed.clone();
    every_step.clock.steps_per_sample = 1;
    every_step.clock.samples = STEPS + 1;
    // The gravity torques of a horizontal arm change nothing, and motors that stop at once have no
    // settling time.
    let idle = [
        "gravity_torque_1",
        "gravity_torque_2",
        "friction_settling_time",
    ];
    let all: Vec<Source> = (0..names.len())
        .filter(|&k| !idle.contains(&names[k].0))
        .map(Source::Parameter)
        .collect();
    assert_eq!(all.len(), 25);
    // as wide as the whole-arm fit's own; what its taps are costs nothing
    let low_pass = Decimation::new(vec![vec![0.01; 14 * 8]; 2], 8);
    for (name, task, member, low_pass) in [
        ("two links", &plain, at_once, None),
        ("with sensors", &sensed, at_once, None),
        ("with sensors at every step", &every_step, at_once, None),
        (
            "through a low-pass",
            &every_step,
            at_once,
            low_pass.as_ref(),
        ),
        (
            "so, and friction settles",
            &every_step,
            settling,
            low_pass.as_ref(),
        ),
    ] {
        for width in widths() {
            let mut best = [f64::INFINITY; 4];
            for _ in 0..400 {
                let begin = Instant::now();
                assert!(simulate(task, &[member], width)[0].is_ok());
                best[0] = best[0].min(begin.elapsed().as_secs_f64());
                for (best, directions) in best[1..].iter_mut().zip([&[], &all[..15], &all]) {
                    let begin = Instant::now();
                    assert!(sensitivities(task, &member, directions, low_pass, width).is_ok());
                    *best = best.min(begin.elapsed().as_secs_f64());
                }
            }
            let steps = STEPS as f64;
            let [plain, shared, few, many] = best.map(|time| time / steps * 1e9);
            println!(
                "{name}, {width:?}: {plain:.1} ns a step; what derivatives share {:.1} more; \
                 with 15 derivatives {few:.1}, {:.2} times; with 25 {many:.1}, {:.2} times",
                shared - plain,
                few / plain,
                many / plain
            );
        }
    }
}
