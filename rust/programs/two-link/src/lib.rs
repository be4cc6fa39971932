//! Programs of the planar two-link arm.

use strainwave_core::arm::TwoLink;
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{
    FastPrograms, GeneralPrograms, forward_avx512, simulate, simulate_together,
    simulate_together_avx512,
};

type Arm = TwoLink<true>;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, 2> = GeneralPrograms::compile();

/// Programs for linear and three-slope gears. Derivatives on AVX2 use the general program, which
/// takes less than 10 % longer.
pub static FAST: FastPrograms<Arm, 2> = FastPrograms {
    simulation: simulate::<Arm, Slopes, 2, false>,
    together: Some(simulate_together::<Arm, Slopes, 2>),
    together_avx512: Some(simulate_together_avx512::<Arm, Slopes, 2>),
    forward: GENERAL.forward,
    forward_avx512: forward_avx512::<Arm, Slopes, 2, true>,
};
