//! Experiments on chains whose number of joints the compiler knows.

use super::{Initial, Member, Record, Task};
use crate::actuation::Servo;
use crate::arm::{SerialChain, first_joints};
use crate::plant::config::Config;
use crate::program::Case;

/// Inputs of a member, with arrays of as many numbers as a chain has joints.
struct Inputs<const LENGTH: usize> {
    feed_forward: Vec<[f64; LENGTH]>,
    reference: Vec<[f64; LENGTH]>,
}

impl<const LENGTH: usize> Inputs<LENGTH> {
    fn of<const N: usize>(member: &Member<'_, N>) -> Self {
        let rows = |rows: &[[f64; N]]| rows.iter().map(first_joints).collect();
        Self {
            feed_forward: rows(member.feed_forward),
            reference: rows(member.reference),
        }
    }

    fn member<'a, const N: usize>(&'a self, of: &Member<'a, N>) -> Member<'a, LENGTH> {
        let initial = &of.initial;
        Member {
            parameters: of.parameters,
            feed_forward: &self.feed_forward,
            reference: &self.reference,
            initial: Initial {
                motor_angle: first_joints(&initial.motor_angle),
                motor_velocity: first_joints(&initial.motor_velocity),
                link_angle: initial.link_angle.as_ref().map(first_joints),
                link_velocity: first_joints(&initial.link_velocity),
                voltage: first_joints(&initial.voltage),
            },
        }
    }
}

fn task_of<const N: usize, const LENGTH: usize>(
    task: &Task<SerialChain<N>, N>,
) -> Task<SerialChain<LENGTH, true>, LENGTH> {
    let config = &task.config;
    Task {
        config: Config {
            arm: config.arm.with_known_length(),
            corner: config.corner,
            joints: first_joints(&config.joints),
        },
        clock: task.clock,
        servo: task.servo.as_ref().map(Servo::of_first_joints),
        record: task.record.clone(),
        link_sensors: task.link_sensors.clone(),
    }
}

/// Runs work with arrays of as many numbers as the chain has joints.
///
/// # Panics
/// The chain has another number of joints than `LENGTH`.
pub fn with_known_length<T, const N: usize, const LENGTH: usize>(
    task: &Task<SerialChain<N>, N>,
    member: &Member<'_, N>,
    work: impl FnOnce(&Task<SerialChain<LENGTH, true>, LENGTH>, &Member<'_, LENGTH>) -> T,
) -> T {
    let inputs = Inputs::of(member);
    work(&task_of(task), &inputs.member(member))
}

/// As [`with_known_length`], for several cases.
///
/// # Panics
/// A chain has another number of joints than `LENGTH`.
pub fn all_with_known_length<T, const N: usize, const LENGTH: usize>(
    cases: &[Case<'_, SerialChain<N>, N>],
    work: impl FnOnce(&[Case<'_, SerialChain<LENGTH, true>, LENGTH>]) -> T,
) -> T {
    let inputs: Vec<_> = cases.iter().map(|(_, member)| Inputs::of(member)).collect();
    let mut known = Vec::with_capacity(cases.len());
    for ((task, member), inputs) in cases.iter().zip(&inputs) {
        known.push((task_of(task), inputs.member(member)));
    }
    work(&known)
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
