//! Programs of the serial chain of 7 joints.

use strainwave_core::arm::SerialChain;
use strainwave_core::program::GeneralPrograms;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<SerialChain<7>, 7> = GeneralPrograms::compile();
