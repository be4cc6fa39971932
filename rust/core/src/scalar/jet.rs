//! Numbers with one derivative, lane by lane.

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{Real, Work};

/// A number and its derivative in one direction: unlike those of [`super::Dual`], each lane has its
/// own.
///
/// `min`, `max`, `abs` and `copysign` take the branch of the value.
#[derive(Clone, Copy, Debug)]
pub struct Jet<R> {
    /// The number.
    pub value: R,
    /// Its derivative.
    pub tangent: R,
}

impl<R: Real> Jet<R> {
    /// A number that depends on nothing.
    #[inline(always)]
    pub fn constant(value: R) -> Self {
        let tangent = R::splat(0.0);
        Self { value, tangent }
    }

    /// In each lane one of two numbers.
    #[inline(always)]
    fn choose(self, other: Self, first: impl Fn(f64, f64) -> bool) -> Self {
        let mut all = self;
        for lane in 0..R::LANES {
            if !first(self.value.lane(lane), other.value.lane(lane)) {
                all.set_one(lane, other.one(lane));
            }
        }
        all
    }
}

impl<R: Real> Add for Jet<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            tangent: self.tangent + other.tangent,
        }
    }
}

impl<R: Real> Sub for Jet<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self {
            value: self.value - other.value,
            tangent: self.tangent - other.tangent,
        }
    }
}

impl<R: Real> Mul for Jet<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            tangent: self
                .value
                .mul_add(other.tangent, self.tangent * other.value),
        }
    }
}

impl<R: Real> Div for Jet<R> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        let tangent = (self.tangent - value * other.tangent) / other.value;
        Self { value, tangent }
    }
}

impl<R: Real> Neg for Jet<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            value: -self.value,
            tangent: -self.tangent,
        }
    }
}

impl<R: Real> Real for Jet<R> {
    const LANES: usize = R::LANES;
    type One = Jet<R::One>;

    #[inline(always)]
    fn scope<W: Work>(work: W) -> W::Output {
        R::scope(work)
    }
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self::constant(R::splat(value))
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        let own = self.tangent.mul_add(factor.value, term.tangent);
        Self {
            value: self.value.mul_add(factor.value, term.value),
            tangent: self.value.mul_add(factor.tangent, own),
        }
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.copysign(Self::splat(0.0))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.choose(other, |own, other| own < other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.choose(other, |own, other| own > other)
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        let turned = -self;
        let mut all = self;
        for lane in 0..R::LANES {
            let negative = [self, sign].map(|of| of.lane(lane).is_sign_negative());
            if negative[0] != negative[1] {
                all.set_one(lane, turned.one(lane));
            }
        }
        all
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
    #[inline(always)]
    fn one(self, index: usize) -> Jet<R::One> {
        Jet {
            value: self.value.one(index),
            tangent: self.tangent.one(index),
        }
    }
    #[inline(always)]
    fn set_one(&mut self, index: usize, one: Jet<R::One>) {
        self.value.set_one(index, one.value);
        self.tangent.set_one(index, one.tangent);
    }
}
