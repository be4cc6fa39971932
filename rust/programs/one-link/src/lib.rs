//! Programs of the single joint.

use strainwave_core::arm::OneLink;
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{FastPrograms, GeneralPrograms, forward_avx512, simulate};

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<OneLink, 1> = GeneralPrograms::compile();

/// Programs for linear and three-slope gears. Derivatives on AVX2 use the general program, which
/// takes less than 10 % longer.
pub static FAST: FastPrograms<OneLink, 1> = FastPrograms {
    simulation: simulate::<OneLink, Slopes, 1, false>,
    together: None,
    together_avx512: None,
    forward: GENERAL.forward,
    forward_avx512: forward_avx512::<OneLink, Slopes, 1, true>,
};
