//! Dual numbers: a value with its derivatives in several directions.
//!
//! `min`, `max`, `abs` and `copysign` take the branch of the value, as friction events do. Values
//! equal those of the plain scalar bit for bit.

use super::real::{is_pack, operators, tangent_methods};
use super::{Real, Work};

/// A value and its derivatives, one per lane of `V`.
#[derive(Clone, Copy, Debug)]
pub struct Dual<S, V> {
    /// Value.
    pub value: S,
    /// Derivatives.
    pub tangent: V,
}

impl<S: Real, V: Real> Dual<S, V> {
    /// A number with derivatives zero.
    #[inline(always)]
    pub fn constant(value: S) -> Self {
        let tangent = V::splat(0.0);
        Self { value, tangent }
    }

    /// A function of this number, from the function's value and slope.
    #[inline(always)]
    fn chain(self, value: S, slope: S) -> Self {
        let tangent = every::<S, V>(slope) * self.tangent;
        Self { value, tangent }
    }
}

/// The same value in all lanes of the derivatives.
#[inline(always)]
fn every<S: Real, V: Real>(value: S) -> V {
    V::splat(value.lane(0))
}

operators!(
    {S: Real, V: Real} Dual<S, V>,
    |a, b| Dual { value: a.value + b.value, tangent: a.tangent + b.tangent },
    Dual { value: a.value - b.value, tangent: a.tangent - b.tangent },
    {
        let (x, y) = (every::<S, V>(a.value), every::<S, V>(b.value));
        Dual { value: a.value * b.value, tangent: x.mul_add(b.tangent, y * a.tangent) }
    },
    {
        let value = a.value / b.value;
        let scale = every::<S, V>(S::splat(1.0) / b.value);
        let change = (-every::<S, V>(value)).mul_add(b.tangent, a.tangent);
        Dual { value, tangent: change * scale }
    },
    Dual { value: -a.value, tangent: -a.tangent }
);

impl<S: Real, V: Real> Real for Dual<S, V> {
    const LANES: usize = S::LANES;

    is_pack!();
    tangent_methods!(V);

    #[inline(always)]
    fn scope<W: Work>(work: W) -> W::Output {
        const { assert!(S::LANES == 1) };
        V::scope(work)
    }
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self::constant(S::splat(value))
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        let (a, b) = (every::<S, V>(self.value), every::<S, V>(factor.value));
        Self {
            value: self.value.mul_add(factor.value, term.value),
            tangent: a.mul_add(factor.tangent, b.mul_add(self.tangent, term.tangent)),
        }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self.value.lane(0) < other.value.lane(0) {
            self
        } else {
            other
        }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self.value.lane(0) > other.value.lane(0) {
            self
        } else {
            other
        }
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        let negative = |of: S| of.lane(0).is_sign_negative();
        let turns = negative(self.value) != negative(sign.value);
        self.chain(
            self.value.copysign(sign.value),
            S::splat(if turns { -1.0 } else { 1.0 }),
        )
    }
    #[inline(always)]
    fn exp(self) -> Self {
        let value = self.value.exp();
        self.chain(value, value)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.chain(self.value.ln(), S::splat(1.0) / self.value)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
}
