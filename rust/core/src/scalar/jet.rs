//! Jets: numbers with one derivative per lane.

use super::real::{is_pack, operators, tangent_methods};
use super::{Real, Work};

/// A number and its derivative in one direction. In contrast to [`super::Dual`], each lane has a
/// separate derivative.
///
/// `min`, `max`, `abs` and `copysign` take the branch of the value.
#[derive(Clone, Copy, Debug)]
pub struct Jet<R> {
    /// Value.
    pub value: R,
    /// Derivative.
    pub tangent: R,
}

impl<R: Real> Jet<R> {
    /// A number with derivative zero.
    #[inline(always)]
    pub fn constant(value: R) -> Self {
        let tangent = R::splat(0.0);
        Self { value, tangent }
    }

    /// Replaces value and derivative of one lane.
    #[inline(always)]
    fn take_lane(&mut self, lane: usize, other: Self) {
        self.value.set_lane(lane, other.value.lane(lane));
        self.tangent.set_lane(lane, other.tangent.lane(lane));
    }

    /// Selects one of two numbers in each lane.
    #[inline(always)]
    fn choose(self, other: Self, first: impl Fn(f64, f64) -> bool) -> Self {
        let mut all = self;
        for lane in 0..R::LANES {
            if !first(self.value.lane(lane), other.value.lane(lane)) {
                all.take_lane(lane, other);
            }
        }
        all
    }
}

operators!(
    {R: Real} Jet<R>,
    |a, b| Jet { value: a.value + b.value, tangent: a.tangent + b.tangent },
    Jet { value: a.value - b.value, tangent: a.tangent - b.tangent },
    Jet { value: a.value * b.value, tangent: a.value.mul_add(b.tangent, a.tangent * b.value) },
    {
        let value = a.value / b.value;
        Jet { value, tangent: (a.tangent - value * b.tangent) / b.value }
    },
    Jet { value: -a.value, tangent: -a.tangent }
);

impl<R: Real> Real for Jet<R> {
    const LANES: usize = R::LANES;

    is_pack!();
    tangent_methods!(R);

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
        let tangent = self.tangent.mul_add(factor.value, term.tangent);
        Self {
            value: self.value.mul_add(factor.value, term.value),
            tangent: self.value.mul_add(factor.tangent, tangent),
        }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.choose(other, |this, other| this < other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.choose(other, |this, other| this > other)
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        let negated = -self;
        let mut all = self;
        for lane in 0..R::LANES {
            let negative = [self, sign].map(|of| of.lane(lane).is_sign_negative());
            if negative[0] != negative[1] {
                all.take_lane(lane, negated);
            }
        }
        all
    }
    #[inline(always)]
    fn exp(self) -> Self {
        let value = self.value.exp();
        Self {
            value,
            tangent: value * self.tangent,
        }
    }
    #[inline(always)]
    fn ln(self) -> Self {
        Self {
            value: self.value.ln(),
            tangent: self.tangent / self.value,
        }
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        let of = |value, slope: R| Self {
            value,
            tangent: slope * self.tangent,
        };
        (of(sin, cos), of(cos, -sin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A function that uses every operation.
    fn mixed<R: Real>(x: R) -> R {
        let (sin, cos) = x.sin_cos();
        let ratio = (sin - x) / (cos + 2.0);
        let ratio = ratio * (-x).exp();
        let bent = ratio.abs().max(R::splat(0.1)).min(R::splat(0.3));
        bent.mul_add(x, -(ratio * cos)).copysign(x * sin) + x
    }

    proptest! {
        #[test]
        fn tangent_matches_difference(x in -3.0..3.0f64) {
            let actual = mixed(Jet { value: x, tangent: 2.0 });
            prop_assert_eq!(actual.value, mixed(x));
            let h = 1e-5;
            let sides = [mixed(x + h) - mixed(x), mixed(x) - mixed(x - h)].map(|rise| rise / h);
            // no slope exists where a branch changes in between
            prop_assume!((sides[0] - sides[1]).abs() < 1e-3);
            // h^2 / 6 times the third derivative, which is below 10^3
            prop_assert!((actual.tangent - (sides[0] + sides[1])).abs() < 1e-7);
        }

        #[test]
        fn root_derivative_follows_implicit_function_theorem(root in 0.1..3.0f64) {
            let square = Jet { value: root * root, tangent: 1.0 };
            let actual = Jet::root(root, |at| at * at - square);
            prop_assert_eq!(actual.value, root);
            prop_assert!((actual.tangent - 0.5 / root).abs() < 1e-14 / root);
        }
    }
}
