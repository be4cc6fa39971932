//! Registers of x86-64 processors.

use std::arch::x86_64::*;

use super::{Lanes, MAX_LANES, Packed, Real, Work, is_pack, operators, vector};

/// Registers that hold the numbers of several joints.
pub type Pack = F64x4;

/// Runs work compiled for the baseline of the target.
#[inline(always)]
unsafe fn with_baseline<W: Work>(work: W) -> W::Output {
    work.run()
}

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

vector!(
    /// Two numbers; SSE2, which every processor has.
    F64x2, __m128d, 2, with_baseline,
    _mm_add_pd, _mm_sub_pd, _mm_mul_pd, _mm_div_pd, multiply_add, _mm_min_pd, _mm_max_pd, _mm_set1_pd,
    |x| _mm_movemask_pd(_mm_cmplt_pd(x, _mm_setzero_pd())) != 0,
    |magnitude, sign| {
        let mask = _mm_set1_pd(-0.0);
        _mm_or_pd(_mm_andnot_pd(mask, magnitude), _mm_and_pd(mask, sign))
    }
);

/// a b + c, rounded twice.
#[inline(always)]
unsafe fn multiply_add(a: __m128d, b: __m128d, c: __m128d) -> __m128d {
    unsafe { _mm_add_pd(_mm_mul_pd(a, b), c) }
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

impl Packed for F64x4 {
    #[inline(always)]
    fn spread_end(self, last: bool) -> Self {
        // SAFETY (here and below): the processor has the feature, see the top of the module.
        Self(unsafe {
            if last {
                _mm256_permute4x64_pd::<0b11_11_11_11>(self.0)
            } else {
                _mm256_permute4x64_pd::<0>(self.0)
            }
        })
    }
    #[inline(always)]
    fn shift_up(self, two: bool, fill: f64) -> Self {
        Self(unsafe {
            let fill = _mm256_set1_pd(fill);
            if two {
                _mm256_permute2f128_pd::<0x20>(fill, self.0)
            } else {
                _mm256_blend_pd::<1>(_mm256_permute4x64_pd::<0b10_01_00_00>(self.0), fill)
            }
        })
    }
    #[inline(always)]
    fn shift_down(self, two: bool) -> Self {
        Self(unsafe {
            let zero = _mm256_setzero_pd();
            if two {
                _mm256_permute2f128_pd::<0x21>(self.0, zero)
            } else {
                _mm256_blend_pd::<8>(_mm256_permute4x64_pd::<0b11_11_10_01>(self.0), zero)
            }
        })
    }
}

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
        // SAFETY: the processor has the feature, see the top of the module, and there are as many
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
        // SAFETY: the processor has the feature, see the top of the module.
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
