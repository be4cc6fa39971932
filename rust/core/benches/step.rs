//! Nanoseconds per integrator step: one arm, and a batch side by side on one core.

use std::marker::PhantomData;
use std::time::Instant;

use strainwave_core::arm::TwoLink;
use strainwave_core::config::{Config, GearKind, JointConfig};
use strainwave_core::dispatch::{Width, simulate};
use strainwave_core::effects::EffectKinds;
use strainwave_core::gear::CORNER;
use strainwave_core::simulate::{Clock, Initial, Member, Quantity, Task};

const SECONDS: usize = 4;
const STEPS_PER_SECOND: usize = 8000;

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
        effects: EffectKinds::default(),
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
            step: 1.0 / STEPS_PER_SECOND as f64,
            steps_per_tick: 8,
            steps_per_servo: 8,
            steps_per_sample: 8,
            samples: SECONDS * STEPS_PER_SECOND / 8 + 1,
        },
        servo: None,
        record,
    }
}

fn main() {
    // Random telegraph voltage of +-10 V on joint 1; joint 2 swings free.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let voltage: Vec<[f64; 2]> = (0..=SECONDS * 1000)
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
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = one_core.expect("a thread pool of one");
    let plain = task(vec![Quantity::MotorVelocity]);
    let sensed = task(vec![
        Quantity::Encoder,
        Quantity::Accelerometer,
        Quantity::Gyro,
    ]);
    for (name, task) in [("two links", &plain), ("with sensors", &sensed)] {
        for width in [Width::Portable, Width::Avx2, Width::Avx512] {
            if width > Width::detect() {
                continue;
            }
            for members in [1, 8 * width.lanes()] {
                let all = vec![member; members];
                let mut best = f64::INFINITY;
                for _ in 0..7 {
                    let begin = Instant::now();
                    let results = pool.install(|| simulate(task, &all, width));
                    best = best.min(begin.elapsed().as_secs_f64());
                    assert!(results.iter().all(Result::is_ok));
                }
                let steps = (members * SECONDS * STEPS_PER_SECOND) as f64;
                println!(
                    "{name}, {width:?}, {members} arms: {:.1} ns a step",
                    best / steps * 1e9
                );
            }
        }
    }
}
