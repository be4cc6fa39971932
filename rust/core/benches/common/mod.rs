//! The arm and the run that the benches share: the built-in SCARA-type arm with 5 kg at its tip,
//! joint 1 under a random telegraph voltage, joint 2 swinging free.

use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use strainwave_core::arm::TwoLink;
use strainwave_core::dispatch::Width;
use strainwave_core::experiment::{Clock, Initial, Member, Quantity, Task};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::{CORNER, GearLaw, ThreeSlope};
use strainwave_core::plant::config::{Config, JointConfig};

/// Integrator steps from one sample, and from one voltage, to the next.
const STEPS_PER_TICK: usize = 8;

/// The arm's parameters, in the order of their names.
const PARAMETERS: [f64; 29] = [
    1.6097, 0.64425, 0.7875, 0.0, 0.0, //
    1.5e-4, 2e-4, 0.06, 0.0, 0.5, 16e3, 25e3, 29e3, 7.0, 25.0, 20.0, 0.0, //
    0.5e-4, 0.8e-4, 0.03, 0.0, 0.15, 4.7e3, 6.1e3, 7.1e3, 2.0, 6.9, 4.0, 0.0,
];

/// So many steps of 0.125 ms, recorded at every eighth.
pub fn task(steps: usize, record: Vec<Quantity>) -> Task<TwoLink<false>, 2> {
    let joint = |torque_per_volt| JointConfig {
        gear: ThreeSlope::LAW,
        ratio: 0.01,
        torque_per_volt,
        current_loop_hz: Some(1000.0),
        encoder_counts: Some(8192.0),
        accelerometer_hz: Some(300.0),
        gyro_hz: Some(5.0),
        imu_accelerometer_hz: None,
        imu_gyro_hz: None,
        effects: EffectKinds::default(),
    };
    Task {
        config: Config {
            arm: TwoLink {
                link_length: 0.35,
                gravity: 0.0,
                accelerometer_distance: [0.33, 0.27],
            },
            corner: CORNER,
            joints: [joint(0.08), joint(0.03)],
        },
        clock: Clock {
            step: 1.25e-4,
            steps_per_tick: STEPS_PER_TICK,
            steps_per_servo: STEPS_PER_TICK,
            steps_per_sample: STEPS_PER_TICK,
            samples: steps / STEPS_PER_TICK + 1,
        },
        servo: None,
        record,
    }
}

/// Random telegraph voltage of +-10 V on joint 1, for so many steps.
pub fn telegraph(steps: usize) -> Vec<[f64; 2]> {
    let mut draw = SmallRng::seed_from_u64(1);
    (0..=steps / STEPS_PER_TICK)
        .map(|_| [if draw.random() { 10.0 } else { -10.0 }, 0.0])
        .collect()
}

/// The arm at rest, under a voltage; the reference has no servo that would follow it.
pub fn member(voltage: &[[f64; 2]]) -> Member<'_, 2> {
    Member {
        parameters: &PARAMETERS,
        feed_forward: voltage,
        reference: voltage,
        initial: Initial {
            motor_angle: [0.0; 2],
            motor_velocity: [0.0; 2],
            link_angle: None,
            link_velocity: [0.0; 2],
            voltage: [0.0; 2],
        },
    }
}

/// What this processor has.
pub fn widths() -> impl Iterator<Item = Width> {
    [Width::Portable, Width::Avx2, Width::Avx512]
        .into_iter()
        .filter(|&width| width <= Width::detect())
}
