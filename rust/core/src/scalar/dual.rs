//! Dual numbers: a value with its derivatives in several directions.
//!
//! `min`, `max`, `abs` and `copysign` take the branch of the value, as friction events do. Values
//! equal those of the plain scalar bit for bit.

use std::ops::{Add, Div, Mul, Neg, Sub};

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

impl<S: Real, V: Real> Add for Dual<S, V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            tangent: self.tangent + other.tangent,
        }
    }
}

impl<S: Real, V: Real> Sub for Dual<S, V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self {
            value: self.value - other.value,
            tangent: self.tangent - other.tangent,
        }
    }
}

impl<S: Real, V: Real> Mul for Dual<S, V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (a, b) = (every::<S, V>(self.value), every::<S, V>(other.value));
        Self {
            value: self.value * other.value,
            tangent: a.mul_add(other.tangent, b * self.tangent),
        }
    }
}

impl<S: Real, V: Real> Div for Dual<S, V> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        let scale = every::<S, V>(S::splat(1.0) / other.value);
        let change = (-every::<S, V>(value)).mul_add(other.tangent, self.tangent);
        Self {
            value,
            tangent: change * scale,
        }
    }
}

impl<S: Real, V: Real> Neg for Dual<S, V> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            value: -self.value,
            tangent: -self.tangent,
        }
    }
}

impl<S: Real, V: Real> Real for Dual<S, V> {
    const LANES: usize = S::LANES;

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
    fn abs(self) -> Self {
        self.copysign(Self::splat(0.0))
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
    fn any_negative(self) -> bool {
        self.value.any_negative()
    }
    #[inline(always)]
    fn lane(self, index: usize) -> f64 {
        self.value.lane(index)
    }
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: f64) {
        self.value.set_lane(index, value);
    }

    /// The root x of f(x, p) = 0 has the derivative x' = -(df/dp) / (df/dx).
    ///
    /// The first evaluation, with derivatives of x zero, gives df/dp. The second one, with
    /// derivatives of x so large that subtracting df/dp loses no digits, gives df/dx.
    fn root(root: f64, f: impl Fn(Self) -> Self) -> Self {
        const FAST: f64 = 18_446_744_073_709_551_616.0; // 2^64
        let mut at = Self::splat(root);
        let rest = f(at).tangent;
        at.tangent = V::splat(FAST);
        let slope = (f(at).tangent - rest) * V::splat(1.0 / FAST);
        at.tangent = -rest / slope;
        at
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
