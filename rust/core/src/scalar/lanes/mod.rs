//! Vectors of `f64` in the registers of a processor, one file per architecture.
//!
//! Inside [`Real::scope`] their operations are single instructions; they are forced inline. Every
//! `unsafe` below is sound because this module is private to the crate, and [`crate::program`] is
//! the only module that names its types, after it has checked the processor's features. Code
//! outside the crate cannot use these types:
//!
//! ```compile_fail,E0603
//! use strainwave_core::scalar::lanes::Fused;
//! ```

#[cfg(target_arch = "aarch64")]
mod aarch64;
#[cfg(target_arch = "x86_64")]
mod x86_64;

#[cfg(target_arch = "aarch64")]
pub use aarch64::*;
#[cfg(target_arch = "x86_64")]
pub use x86_64::*;

use super::real::{is_pack, one_lane, operators};
use super::{Lanes, MAX_LANES, Real, Work};

/// Registers with fused multiply-add that hold the numbers of several joints.
pub trait Packed: Lanes {
    /// The last number in all lanes, or the first.
    fn spread_end(self, last: bool) -> Self;
    /// Moves the numbers by one or two lanes up, filled with a constant.
    fn shift_up(self, two: bool, fill: f64) -> Self;
    /// Moves the numbers by one or two lanes down, filled with zeros.
    fn shift_down(self, two: bool) -> Self;
}

/// One number, with fused multiply-add.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub struct Fused(f64);

one_lane!(Fused);

operators!(
    {} Fused,
    |a, b| Fused(a.0 + b.0),
    Fused(a.0 - b.0),
    Fused(a.0 * b.0),
    Fused(a.0 / b.0),
    Fused(-a.0)
);

impl Real for Fused {
    const LANES: usize = 1;
    type Pack = Pack;
    const PACKED: usize = Pack::LANES;
    #[inline(always)]
    fn pack(from: &[Self]) -> Pack {
        // SAFETY: `Fused` is an f64.
        Pack::load(unsafe { &*(from as *const [Self] as *const [f64]) })
    }
    #[inline(always)]
    fn unpack(pack: Pack, to: &mut [Self]) {
        // SAFETY: as in `pack`.
        pack.store(unsafe { &mut *(to as *mut [Self] as *mut [f64]) });
    }
    #[inline(always)]
    fn pack_constants(from: &[f64]) -> Pack {
        Pack::load(from)
    }
    #[inline(always)]
    fn spread(self) -> Pack {
        Pack::splat(self.0)
    }
    #[inline(always)]
    fn spread_end(pack: Pack, last: bool) -> Pack {
        pack.spread_end(last)
    }
    #[inline(always)]
    fn shift_up(pack: Pack, two: bool, fill: f64) -> Pack {
        pack.shift_up(two, fill)
    }
    #[inline(always)]
    fn shift_down(pack: Pack, two: bool) -> Pack {
        pack.shift_down(two)
    }
    #[inline(always)]
    fn scope<W: Work>(work: W) -> W::Output {
        Pack::scope(work)
    }
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Fused(value)
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Fused(f64::mul_add(self.0, factor.0, term.0))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Fused(self.0.abs())
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Fused(Real::min(self.0, other.0))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Fused(Real::max(self.0, other.0))
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        Fused(f64::copysign(self.0, sign.0))
    }
    #[inline(always)]
    fn any_negative(self) -> bool {
        self.0 < 0.0
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self.0
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: f64) {
        self.0 = value;
    }
}

/// A register and its operations: add, subtract, multiply, divide, multiply and add, minimum,
/// maximum, the same number in all lanes, whether one is negative, and copy of signs.
macro_rules! vector {
    ($(#[$doc:meta])* $name:ident, $register:ty, $lanes:literal, $with:ident,
     $add:ident, $sub:ident, $mul:ident, $div:ident, $fma:ident, $min:ident, $max:ident,
     $splat:ident, |$x:ident| $negative:expr, |$m:ident, $s:ident| $copysign:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        #[repr(transparent)]
        pub struct $name($register);

        // SAFETY (all of them): the processor has the feature, see the top of the module.
        operators!(
            {} $name,
            |a, b| Self(unsafe { $add(a.0, b.0) }),
            Self(unsafe { $sub(a.0, b.0) }),
            Self(unsafe { $mul(a.0, b.0) }),
            Self(unsafe { $div(a.0, b.0) }),
            Self::splat(-0.0) - a
        );

        impl Real for $name {
            const LANES: usize = $lanes;

            is_pack!();

            #[inline(always)]
            fn scope<W: Work>(work: W) -> W::Output {
                unsafe { $with(work) }
            }
            #[inline(always)]
            fn splat(value: f64) -> Self {
                Self(unsafe { $splat(value) })
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                Self(unsafe { $fma(self.0, factor.0, term.0) })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.copysign(Self::splat(0.0))
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                Self(unsafe { $min(self.0, other.0) })
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                Self(unsafe { $max(self.0, other.0) })
            }
            #[inline(always)]
            fn copysign(self, sign: Self) -> Self {
                let ($m, $s) = (self.0, sign.0);
                Self(unsafe { $copysign })
            }
            #[inline(always)]
            fn any_negative(self) -> bool {
                let $x = self.0;
                unsafe { $negative }
            }
            #[inline(always)]
            fn lane(self, index: usize) -> f64 {
                assert!(index < $lanes);
                // SAFETY: the register consists of that many f64, and the index is checked.
                unsafe { *(&raw const self.0).cast::<f64>().add(index) }
            }
            #[inline(always)]
            fn set_lane(&mut self, index: usize, value: f64) {
                assert!(index < $lanes);
                // SAFETY: as in `lane`.
                unsafe { *(&raw mut self.0).cast::<f64>().add(index) = value }
            }
            #[inline(always)]
            fn load(from: &[f64]) -> Self {
                assert!(from.len() >= $lanes);
                // SAFETY: the slice has as many numbers as the register.
                Self(unsafe { from.as_ptr().cast::<$register>().read_unaligned() })
            }
            #[inline(always)]
            fn store(self, to: &mut [f64]) {
                assert!(to.len() >= $lanes);
                // SAFETY: as in `load`.
                unsafe { to.as_mut_ptr().cast::<$register>().write_unaligned(self.0) }
            }
        }
    };
}
use vector;

#[cfg(test)]
mod tests;
