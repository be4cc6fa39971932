//! Experiments on chains whose number of joints the compiler knows, and programs for them.

use super::{Diverged, Initial, Member, Record, Task};
use crate::actuation::Servo;
use crate::arm::{SerialChain, first_joints};
use crate::joint::gear::Slopes;
use crate::plant::config::Config;
use crate::program::{
    Case, Differentiation, Simulation, SimulationTogether, forward_avx512, simulate,
    simulate_together, simulate_together_avx512,
};
use crate::sensitivity::{Request, Sensitivities};

/// A chain whose number of joints the compiler knows.
pub type Chain<const LENGTH: usize> = SerialChain<LENGTH, true>;

/// Programs of chains of one length, for linear and three-slope gears.
pub struct ChainPrograms<const LENGTH: usize> {
    /// Simulation without effects.
    pub simulation: Simulation<Chain<LENGTH>, LENGTH>,
    /// Simulations at once, as in [`crate::program::FastPrograms`].
    pub together: SimulationTogether<Chain<LENGTH>, LENGTH>,
    /// As `together`, on AVX-512.
    pub together_avx512: SimulationTogether<Chain<LENGTH>, LENGTH>,
    /// Derivatives on AVX-512, as in [`crate::program::FastPrograms`].
    pub forward_avx512: Differentiation<Chain<LENGTH>, LENGTH>,
}

impl<const LENGTH: usize> ChainPrograms<LENGTH> {
    /// Compiles the programs in the calling crate.
    pub const fn compile() -> Self {
        Self {
            simulation: simulate::<Chain<LENGTH>, Slopes, LENGTH, false>,
            together: simulate_together::<Chain<LENGTH>, Slopes, LENGTH>,
            together_avx512: simulate_together_avx512::<Chain<LENGTH>, Slopes, LENGTH>,
            forward_avx512: forward_avx512::<Chain<LENGTH>, Slopes, LENGTH, true>,
        }
    }
}

/// Simulates a chain with a program for its length.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The chain has another number of joints than `LENGTH`.
pub fn simulate_known<const N: usize, const LENGTH: usize>(
    task: &Task<SerialChain<N>, N>,
    member: &Member<'_, N>,
    program: Simulation<Chain<LENGTH>, LENGTH>,
) -> Result<Record<N>, Diverged> {
    let inputs = Inputs::of(member);
    program(&task_of(task), &inputs.member(member)).map(|record| padded(&record))
}

/// Simulates chains at once with a program for their length.
///
/// # Panics
/// A chain has another number of joints than `LENGTH`.
pub fn simulate_all_known<const N: usize, const LENGTH: usize>(
    cases: &[Case<'_, SerialChain<N>, N>],
    program: SimulationTogether<Chain<LENGTH>, LENGTH>,
) -> Vec<Result<Record<N>, Diverged>> {
    let inputs: Vec<_> = cases.iter().map(|(_, member)| Inputs::of(member)).collect();
    let mut known = Vec::with_capacity(cases.len());
    for ((task, member), inputs) in cases.iter().zip(&inputs) {
        known.push((task_of(task), inputs.member(member)));
    }
    let recordings = program(&known).into_iter();
    recordings
        .map(|one| one.map(|record| padded(&record)))
        .collect()
}

/// Simulates a chain with derivatives, with a program for its length.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The chain has another number of joints than `LENGTH`.
pub fn differentiate_known<const N: usize, const LENGTH: usize>(
    request: &Request<'_, SerialChain<N>, N>,
    program: Differentiation<Chain<LENGTH>, LENGTH>,
) -> Result<Sensitivities<N>, Diverged> {
    let inputs = Inputs::of(request.member);
    let sensitivities = program(&Request {
        task: &task_of(request.task),
        member: &inputs.member(request.member),
        directions: request.directions,
        variants: request.variants,
        decimation: request.decimation,
    })?;
    Ok(Sensitivities {
        values: padded(&sensitivities.values),
        tangents: sensitivities.tangents,
    })
}

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
) -> Task<Chain<LENGTH>, LENGTH> {
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

/// A recording with zeros beyond the joints.
fn padded<const LENGTH: usize, const N: usize>(record: &Record<LENGTH>) -> Record<N> {
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
