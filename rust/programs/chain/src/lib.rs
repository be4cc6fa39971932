//! Programs of serial chains of up to seven joints.

use strainwave_core::arm::{Arm as _, MAX_CHAIN_JOINTS, SerialChain};
use strainwave_core::experiment::known_length::{all_with_known_length, padded, with_known_length};
use strainwave_core::experiment::{Diverged, Member, Record, Task};
use strainwave_core::joint::gear::{AllLaws, Slopes};
use strainwave_core::program::{
    Case, Differentiation, FastPrograms, GeneralPrograms, SimulationTogether, dual_numbers_avx512,
    forward, forward_avx512, simulate, simulate_together, simulate_together_avx512,
};
use strainwave_core::sensitivity::{Request, Sensitivities};

type Arm = SerialChain<MAX_CHAIN_JOINTS>;
/// A chain whose length the compiler knows.
type Known<const LENGTH: usize> = SerialChain<LENGTH, true>;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, MAX_CHAIN_JOINTS> = GeneralPrograms {
    dual_numbers_avx512: dual_numbers_avx512::<Arm, AllLaws, MAX_CHAIN_JOINTS, true>,
    ..GeneralPrograms::compile()
};

/// Programs for linear and three-slope gears, of the most frequent lengths.
pub static FAST: FastPrograms<Arm, MAX_CHAIN_JOINTS> = FastPrograms {
    simulation: simulate_chain,
    together: Some(simulate_chains),
    together_avx512: Some(simulate_chains_avx512),
    forward: forward_chain,
    forward_avx512: forward_chain_avx512,
};

fn simulate_chain(
    task: &Task<Arm, MAX_CHAIN_JOINTS>,
    member: &Member<'_, MAX_CHAIN_JOINTS>,
) -> Result<Record<MAX_CHAIN_JOINTS>, Diverged> {
    match task.config.arm.joints() {
        3 => simulate_known::<3>(task, member),
        6 => simulate_known::<6>(task, member),
        7 => simulate_known::<7>(task, member),
        _ => simulate::<Arm, Slopes, MAX_CHAIN_JOINTS, false>(task, member),
    }
}

fn simulate_known<const LENGTH: usize>(
    task: &Task<Arm, MAX_CHAIN_JOINTS>,
    member: &Member<'_, MAX_CHAIN_JOINTS>,
) -> Result<Record<MAX_CHAIN_JOINTS>, Diverged> {
    let simulation = simulate::<Known<LENGTH>, Slopes, LENGTH, false>;
    with_known_length(task, member, simulation).map(|record| padded(&record))
}

type Recordings = Vec<Result<Record<MAX_CHAIN_JOINTS>, Diverged>>;

fn simulate_chains(cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>]) -> Recordings {
    match cases[0].0.config.arm.joints() {
        3 => all_known(cases, simulate_together::<Known<3>, Slopes, 3>),
        6 => all_known(cases, simulate_together::<Known<6>, Slopes, 6>),
        7 => all_known(cases, simulate_together::<Known<7>, Slopes, 7>),
        _ => one_by_one(cases),
    }
}

fn simulate_chains_avx512(cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>]) -> Recordings {
    match cases[0].0.config.arm.joints() {
        3 => all_known(cases, simulate_together_avx512::<Known<3>, Slopes, 3>),
        6 => all_known(cases, simulate_together_avx512::<Known<6>, Slopes, 6>),
        7 => all_known(cases, simulate_together_avx512::<Known<7>, Slopes, 7>),
        _ => one_by_one(cases),
    }
}

fn all_known<const LENGTH: usize>(
    cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>],
    program: SimulationTogether<Known<LENGTH>, LENGTH>,
) -> Recordings {
    let recordings = all_with_known_length(cases, program);
    recordings
        .into_iter()
        .map(|one| one.map(|record| padded(&record)))
        .collect()
}

fn one_by_one(cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>]) -> Recordings {
    cases
        .iter()
        .map(|(task, member)| simulate_chain(task, member))
        .collect()
}

type Derivatives = Result<Sensitivities<MAX_CHAIN_JOINTS>, Diverged>;

fn forward_chain(request: &Request<'_, Arm, MAX_CHAIN_JOINTS>) -> Derivatives {
    match request.task.config.arm.joints() {
        3 => differentiate_known(request, forward::<Known<3>, Slopes, 3, true>),
        _ => (GENERAL.forward)(request),
    }
}

fn forward_chain_avx512(request: &Request<'_, Arm, MAX_CHAIN_JOINTS>) -> Derivatives {
    match request.task.config.arm.joints() {
        3 => differentiate_known(request, forward_avx512::<Known<3>, Slopes, 3, true>),
        6 => differentiate_known(request, forward_avx512::<Known<6>, Slopes, 6, true>),
        7 => differentiate_known(request, forward_avx512::<Known<7>, Slopes, 7, true>),
        _ => (GENERAL.forward)(request),
    }
}

fn differentiate_known<const LENGTH: usize>(
    request: &Request<'_, Arm, MAX_CHAIN_JOINTS>,
    program: Differentiation<Known<LENGTH>, LENGTH>,
) -> Derivatives {
    let Request {
        directions,
        variants,
        decimation,
        ..
    } = *request;
    let sensitivities = with_known_length(request.task, request.member, |task, member| {
        program(&Request {
            task,
            member,
            directions,
            variants,
            decimation,
        })
    })?;
    Ok(Sensitivities {
        values: padded(&sensitivities.values),
        tangents: sensitivities.tangents,
    })
}
