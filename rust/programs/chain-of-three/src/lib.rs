//! Programs of serial chains of three joints.

use strainwave_core::experiment::known_length::{Chain, ChainPrograms};
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{Differentiation, forward};

/// Programs for linear and three-slope gears.
pub static FAST: ChainPrograms<3> = ChainPrograms::compile();

/// Derivatives on AVX2.
pub static FORWARD: Differentiation<Chain<3>, 3> = forward::<Chain<3>, Slopes, 3, true>;
