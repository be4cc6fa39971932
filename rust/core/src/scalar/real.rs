//! The scalar of the equations.
//!
//! The same source serves simulations (`f64`, or a number with fused multiply-add), SIMD lanes, and
//! derivatives with respect to parameters ([`crate::scalar::Dual`]). It has no branches, because
//! all lanes take the same path.

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::Work;

/// Largest number of lanes of any scalar.
pub const MAX_LANES: usize = 8;

/// A real number, or several in lanes.
pub trait Real:
    Copy
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Neg<Output = Self>
{
    /// Number of lanes.
    const LANES: usize;
    /// Whether the number has a derivative. Numbers with derivatives are for rare operations.
    const HAS_DERIVATIVE: bool = false;
    /// The numbers of several joints in one register; the number itself if it has lanes or
    /// derivatives.
    type Pack: Real;
    /// Numbers per pack.
    const PACKED: usize;
    /// The first numbers of a list.
    fn pack(from: &[Self]) -> Self::Pack;
    /// Stores a pack to the beginning of a list.
    fn unpack(pack: Self::Pack, to: &mut [Self]);
    /// The first constants of a list, one per number of a pack.
    fn pack_constants(from: &[f64]) -> Self::Pack;
    /// A pack of equal numbers.
    fn spread(self) -> Self::Pack;
    /// The last number of a pack in all its places, or the first.
    fn spread_end(pack: Self::Pack, last: bool) -> Self::Pack;
    /// Moves the numbers of a pack by one or two places up, filled with a constant.
    fn shift_up(pack: Self::Pack, two: bool, fill: f64) -> Self::Pack;
    /// Moves the numbers of a pack by one or two places down, filled with zeros.
    fn shift_down(pack: Self::Pack, two: bool) -> Self::Pack;
    /// Runs work compiled for the processor features that the operations of this scalar need.
    ///
    /// Outside such a scope each operation would be a call, so every hot function that is not
    /// inlined into a scope opens one. Only [`crate::program`] chooses scalars, after it has
    /// checked the processor.
    fn scope<W: Work>(work: W) -> W::Output;
    /// The same value in every lane.
    fn splat(value: f64) -> Self;
    /// `self * factor + term`, rounded once if the processor has the instruction.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Minimum of two numbers.
    fn min(self, other: Self) -> Self;
    /// Maximum of two numbers.
    fn max(self, other: Self) -> Self;
    /// Absolute value of this number with the sign of another.
    fn copysign(self, sign: Self) -> Self;
    /// Whether any lane is negative.
    fn any_negative(self) -> bool;
    /// Value in one lane.
    fn lane(self, index: usize) -> f64;
    /// Replaces the value in one lane; its derivative does not change.
    fn set_lane(&mut self, index: usize, value: f64);

    /// Loads the first numbers of a list, one per lane.
    #[inline(always)]
    fn load(from: &[f64]) -> Self {
        let mut all = Self::splat(0.0);
        for lane in 0..Self::LANES {
            all.set_lane(lane, from[lane]);
        }
        all
    }
    /// Stores the lanes to the beginning of a list.
    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        for lane in 0..Self::LANES {
            to[lane] = self.lane(lane);
        }
    }

    /// A root of a function, with its derivatives.
    ///
    /// The value of the root is known. Scalars with derivatives compute those of the root from the
    /// function's derivatives there.
    #[inline(always)]
    fn root(root: f64, _: impl Fn(Self) -> Self) -> Self {
        Self::splat(root)
    }

    /// Exponential function.
    #[inline(always)]
    fn exp(self) -> Self {
        let mut all = self;
        for lane in 0..Self::LANES {
            all.set_lane(lane, self.lane(lane).exp());
        }
        all
    }

    /// Natural logarithm.
    #[inline(always)]
    fn ln(self) -> Self {
        let mut all = self;
        for lane in 0..Self::LANES {
            all.set_lane(lane, self.lane(lane).ln());
        }
        all
    }

    /// Sine and cosine, with errors below 4e-16 for arguments below 1e5.
    ///
    /// The argument is reduced by a multiple of pi (Cody and Waite, three parts) and halved. The
    /// Taylor series on [-pi/4, pi/4] are truncated below rounding. The double angle and the parity
    /// of the multiple give the result without a branch.
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        // Adding and subtracting 1.5 * 2^52 rounds to the nearest integer.
        let magic = Self::splat(6_755_399_441_055_744.0);
        let turns = self.mul_add(Self::splat(std::f64::consts::FRAC_1_PI), magic) - magic;
        let mut rest = turns.mul_add(Self::splat(-3.141_592_502_593_994), self);
        rest = turns.mul_add(Self::splat(-1.509_957_883_172_319_3e-7), rest);
        rest = turns.mul_add(Self::splat(-1.078_060_571_631_623_8e-14), rest);
        let half = rest * 0.5;
        let square = half * half;
        let sine = half * series(square, &SINE);
        let cosine = series(square, &COSINE);
        let even = turns.mul_add(Self::splat(0.5), magic) - magic;
        let parity = (turns - (even + even)).abs();
        let sign = parity.mul_add(Self::splat(-2.0), Self::splat(1.0));
        let twice = sine + sine;
        (
            sign * (twice * cosine),
            sign * (-twice).mul_add(sine, Self::splat(1.0)),
        )
    }
}

/// The numbers of several joints in one lane.
#[inline(always)]
pub(crate) fn in_lane<R: Real, S: Real, const N: usize>(numbers: &[R; N], lane: usize) -> [S; N] {
    numbers.map(|number| S::splat(number.lane(lane)))
}

/// 1/1!, -1/3!, 1/5!, ... highest power first.
const SINE: [f64; 8] = [
    -7.647_163_731_819_816e-13,
    1.605_904_383_682_161_3e-10,
    -2.505_210_838_544_172e-8,
    2.755_731_922_398_589_3e-6,
    -1.984_126_984_126_984e-4,
    8.333_333_333_333_333e-3,
    -1.666_666_666_666_666_6e-1,
    1.0,
];
/// 1/0!, -1/2!, 1/4!, ... highest power first.
const COSINE: [f64; 9] = [
    4.779_477_332_387_385e-14,
    -1.147_074_559_772_972_5e-11,
    2.087_675_698_786_81e-9,
    -2.755_731_922_398_589e-7,
    2.480_158_730_158_73e-5,
    -1.388_888_888_888_889e-3,
    4.166_666_666_666_666_4e-2,
    -0.5,
    1.0,
];

#[inline(always)]
fn series<R: Real>(x: R, coefficients: &[f64]) -> R {
    let mut sum = R::splat(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = sum.mul_add(x, R::splat(coefficient));
    }
    sum
}

/// Registers that can move numbers between lanes; dual numbers cannot.
pub trait Lanes: Real {
    /// Selection of one of four numbers for each lane.
    type Selection: Copy + Send + Sync;
    /// Lane `l` receives number `from[l]`; with `None` it does not change.
    fn selection(from: [Option<usize>; MAX_LANES]) -> Self::Selection;
    /// Replaces the selected lanes by numbers of `four`.
    fn replace_selected(self, selection: &Self::Selection, four: &[f64; 4]) -> Self;
    /// Stores lane `l` of all four numbers to `rows[l]`.
    #[inline(always)]
    fn store_rows(four: &[Self; 4], rows: &mut [[f64; 4]]) {
        for lane in 0..Self::LANES {
            rows[lane] = four.map(|number| number.lane(lane));
        }
    }
}

/// Implements [`Lanes`] for a scalar with one lane.
macro_rules! one_lane {
    ($type:ty) => {
        impl $crate::scalar::Lanes for $type {
            type Selection = Option<usize>;
            #[inline(always)]
            fn selection(from: [Option<usize>; MAX_LANES]) -> Option<usize> {
                from[0]
            }
            #[inline(always)]
            fn replace_selected(self, selection: &Option<usize>, four: &[f64; 4]) -> Self {
                selection.map_or(self, |k| Self::splat(four[k]))
            }
        }
    };
}

pub(crate) use one_lane;

one_lane!(f64);

/// Implements the packs of [`Real`] for a scalar that is its own pack.
macro_rules! is_pack {
    () => {
        type Pack = Self;
        const PACKED: usize = 1;
        #[inline(always)]
        fn pack(from: &[Self]) -> Self {
            from[0]
        }
        #[inline(always)]
        fn unpack(pack: Self, to: &mut [Self]) {
            to[0] = pack;
        }
        #[inline(always)]
        fn pack_constants(from: &[f64]) -> Self {
            Self::splat(from[0])
        }
        #[inline(always)]
        fn spread(self) -> Self {
            self
        }
        #[inline(always)]
        fn spread_end(pack: Self, _: bool) -> Self {
            pack
        }
        #[inline(always)]
        fn shift_up(_: Self, _: bool, fill: f64) -> Self {
            Self::splat(fill)
        }
        #[inline(always)]
        fn shift_down(_: Self, _: bool) -> Self {
            Self::splat(0.0)
        }
    };
}
pub(crate) use is_pack;

impl Real for f64 {
    const LANES: usize = 1;

    is_pack!();

    #[inline(always)]
    fn scope<W: Work>(work: W) -> W::Output {
        work.run()
    }
    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }
    /// Rounded twice: without the instruction, `f64::mul_add` would call libm.
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self * factor + term
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        f64::copysign(self, sign)
    }
    #[inline(always)]
    fn any_negative(self) -> bool {
        self < 0.0
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }
    #[inline(always)]
    fn set_lane(&mut self, _: usize, value: f64) {
        *self = value;
    }
}

/// Implements the arithmetic operators for a type, with its generic parameters in braces, also with
/// constants on the right.
macro_rules! operators {
    ({$($generics:tt)*} $type:ty, |$a:ident, $b:ident| $add:expr, $sub:expr, $mul:expr, $div:expr, $neg:expr) => {
        impl<$($generics)*> std::ops::Add for $type {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $add
            }
        }
        impl<$($generics)*> std::ops::Sub for $type {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $sub
            }
        }
        impl<$($generics)*> std::ops::Mul for $type {
            type Output = Self;
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $mul
            }
        }
        impl<$($generics)*> std::ops::Div for $type {
            type Output = Self;
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $div
            }
        }
        impl<$($generics)*> std::ops::Neg for $type {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                let $a = self;
                $neg
            }
        }
        $crate::scalar::real::with_constants!({$($generics)*} $type, Add add, Sub sub, Mul mul);
    };
}
pub(crate) use operators;

/// Implements operators with constants on the right.
macro_rules! with_constants {
    ($generics:tt $type:ty, $($operator:ident $method:ident),*) => {
        $($crate::scalar::real::with_constants!(@ $generics $type, $operator, $method);)*
    };
    (@ {$($generics:tt)*} $type:ty, $operator:ident, $method:ident) => {
        impl<$($generics)*> std::ops::$operator<f64> for $type {
            type Output = Self;
            #[inline(always)]
            fn $method(self, constant: f64) -> Self {
                std::ops::$operator::$method(self, <Self as $crate::scalar::Real>::splat(constant))
            }
        }
    };
}
pub(crate) use with_constants;

/// Methods of [`Real`] for a number with a `value` and a `tangent`, whose type is `$tangent`.
macro_rules! tangent_methods {
    ($tangent:ty) => {
        const HAS_DERIVATIVE: bool = true;

        #[inline(always)]
        fn abs(self) -> Self {
            self.copysign(Self::splat(0.0))
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
            at.tangent = <$tangent>::splat(FAST);
            let slope = (f(at).tangent - rest) * <$tangent>::splat(1.0 / FAST);
            at.tangent = -rest / slope;
            at
        }
    };
}
pub(crate) use tangent_methods;
