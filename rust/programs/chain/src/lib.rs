//! Programs of serial chains of up to seven joints.

use strainwave_core::arm::{MAX_CHAIN_JOINTS, SerialChain};
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{FastPrograms, GeneralPrograms, simulate};

type Arm = SerialChain<MAX_CHAIN_JOINTS>;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, MAX_CHAIN_JOINTS> = GeneralPrograms::compile();

/// Programs for linear and three-slope gears. Derivatives use the general program.
pub static FAST: FastPrograms<Arm, MAX_CHAIN_JOINTS> = FastPrograms {
    simulation: simulate::<Arm, Slopes, MAX_CHAIN_JOINTS, false>,
    forward: GENERAL.forward,
    forward_avx512: GENERAL.forward,
};
