//! The programs of the planar two-link arm.

use strainwave_core::arm::TwoLink;
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{FastPrograms, GeneralPrograms, forward_avx512, simulate};

type Arm = TwoLink<true>;

/// For every gear law and effect.
pub static GENERAL: GeneralPrograms<Arm, 2> = GeneralPrograms::compile();

/// For linear and three-slope gears. On AVX2 the general derivatives cost less than a tenth more.
pub static FAST: FastPrograms<Arm, 2> = FastPrograms {
    simulation: simulate::<Arm, Slopes, 2, false>,
    forward: GENERAL.forward,
    forward_avx512: forward_avx512::<Arm, Slopes, 2, true>,
};
