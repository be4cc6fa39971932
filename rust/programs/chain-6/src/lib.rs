//! Programs of the serial chain of 6 joints.

use strainwave_core::arm::SerialChain;
use strainwave_core::program::GeneralPrograms;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<SerialChain<6>, 6> = GeneralPrograms::compile();
