//! Programs for the baseline of the target, one per arm.
//!
//! On x86-64 only processors without AVX2 use them, so they are compiled for size.

use strainwave_core::arm::{MAX_CHAIN_JOINTS, OneLink, SerialChain, TwoLink};
use strainwave_core::program::{Differentiation, baseline};

/// Planar two-link arm.
pub static TWO_LINK: Differentiation<TwoLink<true>, 2> = baseline::<TwoLink<true>, 2>;
/// Single joint.
pub static ONE_LINK: Differentiation<OneLink, 1> = baseline::<OneLink, 1>;

/// Serial chain.
pub static CHAIN: Differentiation<SerialChain<MAX_CHAIN_JOINTS>, MAX_CHAIN_JOINTS> =
    baseline::<SerialChain<MAX_CHAIN_JOINTS>, MAX_CHAIN_JOINTS>;
