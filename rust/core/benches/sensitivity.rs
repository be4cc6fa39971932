//! Nanoseconds per integrator step on one core: one arm with derivatives, beside the same arm without.

mod common;

use std::time::Instant;

use common::{member, task, telegraph, widths};
use strainwave_core::dispatch::{sensitivities, simulate};
use strainwave_core::experiment::{Quantity, Source};

/// Short, so that among many runs some are left alone by whatever else the machine does.
const STEPS: usize = 2400;

fn main() {
    let voltage = telegraph(STEPS);
    let member = member(&voltage);
    let plain = task(STEPS, vec![Quantity::MotorVelocity]);
    let sensed = task(
        STEPS,
        vec![Quantity::MotorVelocity, Quantity::Accelerometer],
    );
    // The gravity torques of a horizontal arm change nothing, and motors that stop at once have no
    // settling time.
    let names = plain.config.parameter_names();
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
    for (name, task) in [("two links", &plain), ("with sensors", &sensed)] {
        for width in widths() {
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
