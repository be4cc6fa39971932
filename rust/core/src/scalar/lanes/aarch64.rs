//! Registers of aarch64 processors, all of which have NEON and fused multiply-add.

use std::arch::aarch64::*;

use super::{Lanes, MAX_LANES, Packed, Real, Work, is_pack, operators, vector};

/// Registers that hold the numbers of several joints.
pub type Pack = F64x2;

/// Runs work compiled for the baseline of the target.
#[inline(always)]
unsafe fn with_baseline<W: Work>(work: W) -> W::Output {
    work.run()
}

vector!(
    /// Two numbers; NEON.
    F64x2, float64x2_t, 2, with_baseline,
    vaddq_f64, vsubq_f64, vmulq_f64, vdivq_f64, multiply_add, minimum, maximum, vdupq_n_f64,
    |x| vmaxvq_u32(vreinterpretq_u32_u64(vcltzq_f64(x))) != 0,
    |magnitude, sign| vbslq_f64(vdupq_n_u64(1 << 63), sign, magnitude)
);

/// a b + c, rounded once.
#[inline(always)]
unsafe fn multiply_add(a: float64x2_t, b: float64x2_t, c: float64x2_t) -> float64x2_t {
    unsafe { vfmaq_f64(c, a, b) }
}

/// As on x86-64 and for `f64`: the second number if one is not a number.
#[inline(always)]
unsafe fn minimum(a: float64x2_t, b: float64x2_t) -> float64x2_t {
    unsafe { vbslq_f64(vcltq_f64(a, b), a, b) }
}

/// As [`minimum`].
#[inline(always)]
unsafe fn maximum(a: float64x2_t, b: float64x2_t) -> float64x2_t {
    unsafe { vbslq_f64(vcgtq_f64(a, b), a, b) }
}

impl Packed for F64x2 {
    #[inline(always)]
    fn spread_end(self, last: bool) -> Self {
        // SAFETY (here and below): every processor has the feature.
        Self(unsafe {
            if last {
                vdupq_laneq_f64::<1>(self.0)
            } else {
                vdupq_laneq_f64::<0>(self.0)
            }
        })
    }
    #[inline(always)]
    fn shift_up(self, two: bool, fill: f64) -> Self {
        let fill = Self::splat(fill);
        if two {
            fill
        } else {
            Self(unsafe { vzip1q_f64(fill.0, self.0) })
        }
    }
    #[inline(always)]
    fn shift_down(self, two: bool) -> Self {
        let zero = Self::splat(0.0);
        if two {
            zero
        } else {
            Self(unsafe { vextq_f64::<1>(self.0, zero.0) })
        }
    }
}

impl Lanes for F64x2 {
    /// Indices of the bytes of the numbers; indices beyond them select nothing.
    type Selection = [u8; 16];

    fn selection(from: [Option<usize>; MAX_LANES]) -> Self::Selection {
        std::array::from_fn(|byte| from[byte / 8].map_or(u8::MAX, |k| (8 * k + byte % 8) as u8))
    }

    #[inline(always)]
    fn replace_selected(self, bytes: &Self::Selection, four: &[f64; 4]) -> Self {
        // SAFETY: the arrays are as long as one register and two.
        Self(unsafe {
            let table = vld1q_u8_x2(four.as_ptr().cast());
            let selected = vqtbx2q_u8(
                vreinterpretq_u8_f64(self.0),
                table,
                vld1q_u8(bytes.as_ptr()),
            );
            vreinterpretq_f64_u8(selected)
        })
    }
}
