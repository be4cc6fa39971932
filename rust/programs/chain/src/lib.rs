//! Programs of serial chains of up to seven joints. Those of the most frequent lengths are crates of
//! their own, which cargo compiles in parallel.

use strainwave_chain_of_seven::FAST as SEVEN;
use strainwave_chain_of_six::FAST as SIX;
use strainwave_chain_of_three::FAST as THREE;
use strainwave_core::arm::{Arm as _, MAX_CHAIN_JOINTS, SerialChain};
use strainwave_core::experiment::known_length::{
    differentiate_known, simulate_all_known, simulate_known,
};
use strainwave_core::experiment::{Diverged, Member, Record, Task};
use strainwave_core::joint::gear::{AllLaws, Slopes};
use strainwave_core::program::{
    Case, FastPrograms, GeneralPrograms, dual_numbers_avx512, simulate,
};
use strainwave_core::sensitivity::{Request, Sensitivities};

type Arm = SerialChain<MAX_CHAIN_JOINTS>;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, MAX_CHAIN_JOINTS> = GeneralPrograms {
    dual_numbers_avx512: dual_numbers_avx512::<Arm, AllLaws, MAX_CHAIN_JOINTS, true>,
    ..GeneralPrograms::compile()
};

/// Programs for linear and three-slope gears.
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
        3 => simulate_known(task, member, THREE.simulation),
        6 => simulate_known(task, member, SIX.simulation),
        7 => simulate_known(task, member, SEVEN.simulation),
        _ => simulate::<Arm, Slopes, MAX_CHAIN_JOINTS, false>(task, member),
    }
}

type Recordings = Vec<Result<Record<MAX_CHAIN_JOINTS>, Diverged>>;

fn simulate_chains(cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>]) -> Recordings {
    match cases[0].0.config.arm.joints() {
        3 => simulate_all_known(cases, THREE.together),
        6 => simulate_all_known(cases, SIX.together),
        7 => simulate_all_known(cases, SEVEN.together),
        _ => one_by_one(cases),
    }
}

fn simulate_chains_avx512(cases: &[Case<'_, Arm, MAX_CHAIN_JOINTS>]) -> Recordings {
    match cases[0].0.config.arm.joints() {
        3 => simulate_all_known(cases, THREE.together_avx512),
        6 => simulate_all_known(cases, SIX.together_avx512),
        7 => simulate_all_known(cases, SEVEN.together_avx512),
        _ => one_by_one(cases),
    }
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
        3 => differentiate_known(request, strainwave_chain_of_three::FORWARD),
        _ => (GENERAL.forward)(request),
    }
}

fn forward_chain_avx512(request: &Request<'_, Arm, MAX_CHAIN_JOINTS>) -> Derivatives {
    match request.task.config.arm.joints() {
        3 => differentiate_known(request, THREE.forward_avx512),
        6 => differentiate_known(request, SIX.forward_avx512),
        7 => differentiate_known(request, SEVEN.forward_avx512),
        _ => (GENERAL.forward)(request),
    }
}
