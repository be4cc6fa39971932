//! Vectors of `f64` in the registers of x86-64 processors.
//!
//! Inside [`Real::scope`] their operations are single instructions; they are forced inline. Every
//! `unsafe` below is sound because this module is private to the crate, and [`crate::program`] is
//! the only module that names its types, after it has checked the processor's features. Code
//! outside the crate cannot use these types:
//!
//! ```compile_fail,E0603
//! use strainwave_core::scalar::lanes::F64x4;
//! ```

use std::arch::x86_64::*;

use super::real::{is_pack, one_lane, operators};
use super::{Lanes, MAX_LANES, Real, Work};

/// Runs work compiled for AVX2 and fused multiply-add.
///
/// # Safety
/// The processor has both features.
#[target_feature(enable = "avx2,fma")]
pub unsafe fn with_avx2<W: Work>(work: W) -> W::Output {
    work.run()
}

/// Runs work compiled for AVX-512, which includes narrower registers.
///
/// # Safety
/// The processor has AVX-512 and the features that `with_avx2` requires.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
pub unsafe fn with_avx512<W: Work>(work: W) -> W::Output {
    work.run()
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
    type Pack = F64x4;
    const PACKED: usize = 4;
    #[inline(always)]
    fn pack(from: &[Self]) -> F64x4 {
        assert!(from.len() >= 4);
        // SAFETY: `Fused` is an f64, and the slice has as many as the register.
        F64x4(unsafe { from.as_ptr().cast::<__m256d>().read_unaligned() })
    }
    #[inline(always)]
    fn unpack(pack: F64x4, to: &mut [Self]) {
        assert!(to.len() >= 4);
        // SAFETY: as in `pack`.
        unsafe { to.as_mut_ptr().cast::<__m256d>().write_unaligned(pack.0) }
    }
    #[inline(always)]
    fn pack_constants(from: &[f64]) -> F64x4 {
        F64x4::load(from)
    }
    #[inline(always)]
    fn spread(self) -> F64x4 {
        F64x4::splat(self.0)
    }
    #[inline(always)]
    fn spread_end(pack: F64x4, last: bool) -> F64x4 {
        // SAFETY (here and below): the processor has the feature, see the top of this file.
        F64x4(unsafe {
            if last {
                _mm256_permute4x64_pd::<0b11_11_11_11>(pack.0)
            } else {
                _mm256_permute4x64_pd::<0>(pack.0)
            }
        })
    }
    #[inline(always)]
    fn shift_up(pack: F64x4, two: bool, fill: f64) -> F64x4 {
        F64x4(unsafe {
            let fill = _mm256_set1_pd(fill);
            if two {
                _mm256_permute2f128_pd::<0x20>(fill, pack.0)
            } else {
                _mm256_blend_pd::<1>(_mm256_permute4x64_pd::<0b10_01_00_00>(pack.0), fill)
            }
        })
    }
    #[inline(always)]
    fn shift_down(pack: F64x4, two: bool) -> F64x4 {
        F64x4(unsafe {
            let zero = _mm256_setzero_pd();
            if two {
                _mm256_permute2f128_pd::<0x21>(pack.0, zero)
            } else {
                _mm256_blend_pd::<8>(_mm256_permute4x64_pd::<0b11_11_10_01>(pack.0), zero)
            }
        })
    }
    #[inline(always)]
    fn scope<W: Work>(work: W) -> W::Output {
        // SAFETY: the processor has the features, see the top of this file.
        unsafe { with_avx2(work) }
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

macro_rules! vector {
    ($(#[$doc:meta])* $name:ident, $register:ty, $lanes:literal, $with:ident,
     $add:ident, $sub:ident, $mul:ident, $div:ident, $fma:ident, $min:ident, $max:ident,
     $splat:ident, |$x:ident| $negative:expr, |$m:ident, $s:ident| $copysign:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        #[repr(transparent)]
        pub struct $name($register);

        // SAFETY (all of them): the processor has the feature, see the top of this file.
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

vector!(
    /// Four numbers; features `avx2,fma`.
    F64x4, __m256d, 4, with_avx2,
    _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_fmadd_pd,
    _mm256_min_pd, _mm256_max_pd, _mm256_set1_pd,
    |x| _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(x, _mm256_setzero_pd())) != 0,
    |magnitude, sign| {
        let mask = _mm256_set1_pd(-0.0);
        _mm256_or_pd(_mm256_andnot_pd(mask, magnitude), _mm256_and_pd(mask, sign))
    }
);

vector!(
    /// Eight numbers; features `avx512f,avx512vl,avx512dq,avx512bw`.
    F64x8, __m512d, 8, with_avx512,
    _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_fmadd_pd,
    _mm512_min_pd, _mm512_max_pd, _mm512_set1_pd,
    |x| _mm512_cmp_pd_mask::<_CMP_LT_OQ>(x, _mm512_setzero_pd()) != 0,
    |magnitude, sign| {
        let mask = _mm512_castpd_si512(_mm512_set1_pd(-0.0));
        let magnitude = _mm512_andnot_si512(mask, _mm512_castpd_si512(magnitude));
        let sign = _mm512_and_si512(mask, _mm512_castpd_si512(sign));
        _mm512_castsi512_pd(_mm512_or_si512(magnitude, sign))
    }
);

impl Lanes for F64x4 {
    /// A negative number in each selected lane, and the indices of the two halves of each
    /// number.
    type Selection = ([f64; 4], [i32; 8]);

    fn selection(from: [Option<usize>; MAX_LANES]) -> Self::Selection {
        let mask = std::array::from_fn(|lane| from[lane].map_or(0.0, |_| -1.0));
        let half = |at: usize| from[at / 2].map_or(0, |k| (2 * k + at % 2) as i32);
        (mask, std::array::from_fn(half))
    }

    #[inline(always)]
    fn replace_selected(self, (mask, indices): &Self::Selection, four: &[f64; 4]) -> Self {
        let (four, mask) = (Self::load(four), Self::load(mask));
        // SAFETY: the processor has the feature, see the top of this file, and there are as many
        // indices as the register holds.
        Self(unsafe {
            let indices = _mm256_loadu_si256(indices.as_ptr().cast());
            let permuted = _mm256_permutevar8x32_ps(_mm256_castpd_ps(four.0), indices);
            _mm256_blendv_pd(self.0, _mm256_castps_pd(permuted), mask.0)
        })
    }

    #[inline(always)]
    fn store_rows(four: &[Self; 4], rows: &mut [[f64; 4]]) {
        let [a, b, c, d] = four.map(|vector| vector.0);
        // SAFETY: the processor has the feature, see the top of this file.
        let transposed = unsafe {
            let (ab, cd) = (_mm256_unpacklo_pd(a, b), _mm256_unpacklo_pd(c, d));
            let (high_ab, high_cd) = (_mm256_unpackhi_pd(a, b), _mm256_unpackhi_pd(c, d));
            [
                _mm256_permute2f128_pd::<0x20>(ab, cd),
                _mm256_permute2f128_pd::<0x20>(high_ab, high_cd),
                _mm256_permute2f128_pd::<0x31>(ab, cd),
                _mm256_permute2f128_pd::<0x31>(high_ab, high_cd),
            ]
        };
        let rows = &mut rows[..4];
        for lane in 0..4 {
            Self(transposed[lane]).store(&mut rows[lane]);
        }
    }
}

impl Lanes for F64x8 {
    /// A bit for each selected lane, and the indices of the numbers.
    type Selection = (u8, [i64; 8]);

    fn selection(from: [Option<usize>; MAX_LANES]) -> Self::Selection {
        let bits = from.iter().enumerate();
        let mask = bits.fold(0, |all, (lane, k)| all | u8::from(k.is_some()) << lane);
        (mask, from.map(|k| k.unwrap_or(0) as i64))
    }

    #[inline(always)]
    fn replace_selected(self, (mask, indices): &Self::Selection, four: &[f64; 4]) -> Self {
        let four = F64x4::load(four);
        // SAFETY: as in `F64x4`.
        Self(unsafe {
            let indices = _mm512_loadu_epi64(indices.as_ptr());
            let twice = _mm512_broadcast_f64x4(four.0);
            _mm512_mask_permutexvar_pd(self.0, *mask, indices, twice)
        })
    }
}
