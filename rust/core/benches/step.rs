//! Nanoseconds per integrator step: one arm, and a batch side by side on one core.

mod common;

use std::time::Instant;

use common::{member, task, telegraph, widths};
use strainwave_core::dispatch::simulate;
use strainwave_core::experiment::Quantity;

const STEPS: usize = 32_000;

fn main() {
    let voltage = telegraph(STEPS);
    let member = member(&voltage);
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = one_core.expect("a thread pool of one");
    let plain = task(STEPS, vec![Quantity::MotorVelocity]);
    let sensed = task(
        STEPS,
        vec![Quantity::Encoder, Quantity::Accelerometer, Quantity::Gyro],
    );
    for (name, task) in [("two links", &plain), ("with sensors", &sensed)] {
        for width in widths() {
            for members in [1, 8 * width.lanes()] {
                let all = vec![member; members];
                let mut best = f64::INFINITY;
                for _ in 0..7 {
                    let begin = Instant::now();
                    let results = pool.install(|| simulate(task, &all, width));
                    best = best.min(begin.elapsed().as_secs_f64());
                    assert!(results.iter().all(Result::is_ok));
                }
                let steps = (members * STEPS) as f64;
                println!(
                    "{name}, {width:?}, {members} arms: {:.1} ns a step",
                    best / steps * 1e9
                );
            }
        }
    }
}
