//! Scalars of the equations.

mod aligned;
mod dual;
mod jet;
#[cfg(any(target_arch = "aarch64", target_arch = "x86_64"))]
pub(crate) mod lanes;
mod real;
mod solve;
mod work;

pub(crate) use aligned::Aligned;
pub use dual::Dual;
pub use jet::Jet;
pub(crate) use real::in_lane;
pub use real::{Lanes, MAX_LANES, Real};
pub(crate) use solve::{inverse, solve, symmetrise};
pub use work::Work;
pub(crate) use work::{run_out_of_line, works};
