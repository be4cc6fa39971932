//! Scalars of the equations.

mod aligned;
mod dual;
mod jet;
#[cfg(target_arch = "x86_64")]
pub(crate) mod lanes;
mod real;
mod solve;

pub(crate) use aligned::Aligned;
pub use dual::Dual;
pub use jet::Jet;
pub(crate) use real::run_out_of_line;
pub use real::{Lanes, MAX_LANES, Real, Work};
pub(crate) use solve::{inverse, solve, symmetrise};
