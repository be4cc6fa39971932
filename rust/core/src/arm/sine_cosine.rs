//! Sines and cosines of joint angles.

use crate::scalar::Real;

/// Sine and cosine of one angle.
#[derive(Clone, Copy, Debug)]
pub struct SineCosine<R> {
    pub(super) sin: R,
    pub(super) cos: R,
}

impl<R: Real> SineCosine<R> {
    #[inline(always)]
    pub(super) fn of(angle: R) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    /// Sine and cosine converted by a function.
    #[inline(always)]
    pub(super) fn map<L>(self, to: &impl Fn(R) -> L) -> SineCosine<L> {
        SineCosine {
            sin: to(self.sin),
            cos: to(self.cos),
        }
    }

    /// The sum of two angles.
    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            sin: self.sin.mul_add(other.cos, self.cos * other.sin),
            cos: self.cos.mul_add(other.cos, -(self.sin * other.sin)),
        }
    }

    /// Sum with a small angle: Taylor series; the first neglected term is x^8/8!.
    #[inline(always)]
    pub(super) fn plus_small_angle(self, x: R) -> Self {
        let c = R::splat;
        let square = x * x;
        let sin = square.mul_add(c(-1.0 / 5040.0), c(1.0 / 120.0));
        let sin = sin.mul_add(square, c(-1.0 / 6.0)).mul_add(square, c(1.0)) * x;
        let cos = square.mul_add(c(-1.0 / 720.0), c(1.0 / 24.0));
        let cos = cos.mul_add(square, c(-0.5)).mul_add(square, c(1.0));
        self.plus(Self { sin, cos })
    }
}
