//! Programs for the baseline of the target, one per arm.
//!
//! On x86-64 only processors without AVX2 use them, so they are compiled for size.

use strainwave_core::arm::{OneLink, SerialChain, TwoLink};
use strainwave_core::program::{Differentiation, baseline};

/// Planar two-link arm.
pub static TWO_LINK: Differentiation<TwoLink<true>, 2> = baseline::<TwoLink<true>, 2>;
/// Single joint.
pub static ONE_LINK: Differentiation<OneLink, 1> = baseline::<OneLink, 1>;

macro_rules! chains {
    ($($name:ident: $joints:literal,)*) => {
        $(
            #[doc = concat!("The serial chain, of ", stringify!($joints), " joints.")]
            pub static $name: Differentiation<SerialChain<$joints>, $joints> =
                baseline::<SerialChain<$joints>, $joints>;
        )*
    };
}

chains! {
    CHAIN_1: 1,
    CHAIN_2: 2,
    CHAIN_3: 3,
    CHAIN_4: 4,
    CHAIN_5: 5,
    CHAIN_6: 6,
    CHAIN_7: 7,
}
