//! Programs of serial chains of one to four joints, for every gear law and effect.

use strainwave_core::arm::SerialChain;
use strainwave_core::program::GeneralPrograms;

/// One joint.
pub static GENERAL_1: GeneralPrograms<SerialChain<1>, 1> = GeneralPrograms::compile();
/// Two joints.
pub static GENERAL_2: GeneralPrograms<SerialChain<2>, 2> = GeneralPrograms::compile();
/// Three joints.
pub static GENERAL_3: GeneralPrograms<SerialChain<3>, 3> = GeneralPrograms::compile();
/// Four joints.
pub static GENERAL_4: GeneralPrograms<SerialChain<4>, 4> = GeneralPrograms::compile();
