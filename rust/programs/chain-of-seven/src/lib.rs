//! Programs of serial chains of seven joints.

use strainwave_core::experiment::known_length::ChainPrograms;

/// Programs for linear and three-slope gears.
pub static FAST: ChainPrograms<7> = ChainPrograms::compile();
