//! Programs of the serial chain of 5 joints.

use strainwave_core::arm::SerialChain;
use strainwave_core::program::GeneralPrograms;

/// Programs for every gear law and effect.
pub static GENERAL: GeneralPrograms<SerialChain<5>, 5> = GeneralPrograms::compile();
