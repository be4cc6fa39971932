//! Experiments on chains whose number of joints the compiler knows.

use super::{Initial, Member, Record, Task};
use crate::actuation::Servo;
use crate::arm::{SerialChain, first_joints};
use crate::plant::config::Config;

/// Runs work with arrays of as many numbers as the chain has joints.
///
/// # Panics
/// The chain has another number of joints than `LENGTH`.
pub fn with_known_length<T, const N: usize, const LENGTH: usize>(
    task: &Task<SerialChain<N>, N>,
    member: &Member<'_, N>,
    work: impl FnOnce(&Task<SerialChain<LENGTH, true>, LENGTH>, &Member<'_, LENGTH>) -> T,
) -> T {
    let config = &task.config;
    let task = Task {
        config: Config {
            arm: config.arm.with_known_length(),
            corner: config.corner,
            joints: first_joints(&config.joints),
        },
        clock: task.clock,
        servo: task.servo.as_ref().map(Servo::of_first_joints),
        record: task.record.clone(),
        link_sensors: task.link_sensors.clone(),
    };
    let inputs = [member.feed_forward, member.reference];
    let [feed_forward, reference] =
        inputs.map(|rows| rows.iter().map(first_joints).collect::<Vec<_>>());
    let initial = &member.initial;
    let member = Member {
        parameters: member.parameters,
        feed_forward: &feed_forward,
        reference: &reference,
        initial: Initial {
            motor_angle: first_joints(&initial.motor_angle),
            motor_velocity: first_joints(&initial.motor_velocity),
            link_angle: initial.link_angle.as_ref().map(first_joints),
            link_velocity: first_joints(&initial.link_velocity),
            voltage: first_joints(&initial.voltage),
        },
    };
    work(&task, &member)
}

/// A recording with zeros beyond the joints.
pub fn padded<const LENGTH: usize, const N: usize>(record: &Record<LENGTH>) -> Record<N> {
    let row = |row: &[f64; LENGTH]| {
        let mut all = [0.0; N];
        all[..LENGTH].copy_from_slice(row);
        all
    };
    record
        .iter()
        .map(|rows| rows.iter().map(row).collect())
        .collect()
}
