//! Programs of serial chains of up to seven joints.

use strainwave_core::arm::{Arm as _, MAX_CHAIN_JOINTS, SerialChain};
use strainwave_core::experiment::{Diverged, Member, Record, Task};
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{FastPrograms, GeneralPrograms, simulate};

type Arm<const LENGTH: usize = 0> = SerialChain<MAX_CHAIN_JOINTS, LENGTH>;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, MAX_CHAIN_JOINTS> = GeneralPrograms::compile();

/// Programs for linear and three-slope gears. Derivatives use the general program.
pub static FAST: FastPrograms<Arm, MAX_CHAIN_JOINTS> = FastPrograms {
    simulation: simulate_chain,
    forward: GENERAL.forward,
    forward_avx512: GENERAL.forward,
};

type Outcome = Result<Record<MAX_CHAIN_JOINTS>, Diverged>;

/// The program of the chain's length for the most frequent lengths.
fn simulate_chain(
    task: &Task<Arm, MAX_CHAIN_JOINTS>,
    member: &Member<'_, MAX_CHAIN_JOINTS>,
) -> Outcome {
    match task.config.arm.joints() {
        3 => simulate_length::<3>(task, member),
        6 => simulate_length::<6>(task, member),
        7 => simulate_length::<7>(task, member),
        _ => simulate_length::<0>(task, member),
    }
}

fn simulate_length<const LENGTH: usize>(
    task: &Task<Arm, MAX_CHAIN_JOINTS>,
    member: &Member<'_, MAX_CHAIN_JOINTS>,
) -> Outcome {
    let task = task.with_arm(Arm::with_length);
    simulate::<Arm<LENGTH>, Slopes, MAX_CHAIN_JOINTS, false>(&task, member)
}
