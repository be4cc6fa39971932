//! The list of laws, and sets of laws for which programs are compiled.

use super::three_slope::PerSlope;
use super::{
    Cubic, GearLaw, Gears, Law, Linear, MAX_LAW_PARAMETERS, Spring, ThreeSlope, ThreeSlopeSpring,
};
use crate::scalar::Real;

/// Linear and three-slope gears without a branch: a linear gear has three equal slopes, for which
/// the knees have no effect.
#[derive(Clone, Copy, Debug)]
pub struct Slopes;

/// A linear or three-slope gear.
#[derive(Clone, Copy, Debug)]
pub struct SlopesSpring<R> {
    slopes: ThreeSlopeSpring<R>,
    linear: bool,
}

impl Gears for Slopes {
    type Spring<R: Real> = SlopesSpring<R>;
    const RIGID: bool = false;

    fn includes(law: &Law) -> bool {
        [Linear::LAW, ThreeSlope::LAW].contains(law)
    }

    #[inline(always)]
    fn spring<R: Real>(
        law: &Law,
        values: &[R; MAX_LAW_PARAMETERS],
        corner: f64,
    ) -> SlopesSpring<R> {
        let linear = *law != ThreeSlope::LAW;
        let mut values = *values;
        if linear {
            let (stiffness, one) = (values[0], R::splat(1.0));
            values[..5].copy_from_slice(&[stiffness, stiffness, stiffness, one, one + one]);
        }
        let slopes = ThreeSlope::spring(&values, corner);
        SlopesSpring { slopes, linear }
    }
}

impl<R: Real> Spring<R> for SlopesSpring<R> {
    type Shared = PerSlope<R>;

    #[inline(always)]
    fn torque(&self, delta: R) -> R {
        self.slopes.torque(delta)
    }

    #[inline(always)]
    fn stiffness(&self, delta: R) -> R {
        self.slopes.stiffness(delta)
    }

    #[inline(always)]
    fn energy(&self, delta: R) -> R {
        self.slopes.energy(delta)
    }

    fn least_stiffness(&self, torque: R) -> R {
        self.slopes.least_stiffness(torque)
    }

    #[inline(always)]
    fn shared(&self) -> PerSlope<R> {
        self.slopes.shared()
    }

    #[inline(always)]
    fn by_parameters(&self, delta: R, shared: &PerSlope<R>) -> [R; MAX_LAW_PARAMETERS] {
        if self.linear {
            let mut by = [R::splat(0.0); MAX_LAW_PARAMETERS];
            by[0] = delta;
            by
        } else {
            self.slopes.by_parameters(delta, shared)
        }
    }
}

/// Gears of one law, which may be defined outside of this crate.
#[derive(Clone, Copy, Debug)]
pub struct SingleLaw<L>(std::marker::PhantomData<L>);

impl<L: GearLaw> Gears for SingleLaw<L> {
    type Spring<R: Real> = L::Spring<R>;
    const RIGID: bool = false;

    fn includes(law: &Law) -> bool {
        *law == L::LAW
    }

    #[inline(always)]
    fn spring<R: Real>(_: &Law, values: &[R; MAX_LAW_PARAMETERS], corner: f64) -> L::Spring<R> {
        L::spring(values, corner)
    }
}

/// [`ELASTIC`], [`AllLaws`] with its gear, and `of_law!`, which runs the same code for any law; `$`
/// precedes the variables of the latter.
macro_rules! laws {
    ($dollar:tt $($law:ident)*) => {
        /// Elastic laws.
        pub(super) const ELASTIC: &[Law] = &[$($law::LAW),*];

        /// Gears of all laws of the core, and rigid gears.
        #[derive(Clone, Copy, Debug)]
        pub struct AllLaws;

        /// A gear of any law.
        #[derive(Clone, Copy)]
        pub enum AnySpring<R: Real> {
            $(
                #[doc = concat!("Of [`", stringify!($law), "`].")]
                $law(<$law as GearLaw>::Spring<R>),
            )*
        }

        impl Gears for AllLaws {
            type Spring<R: Real> = AnySpring<R>;
            const RIGID: bool = true;

            fn includes(_: &Law) -> bool {
                true
            }

            #[inline(always)]
            fn spring<R: Real>(
                law: &Law,
                values: &[R; MAX_LAW_PARAMETERS],
                corner: f64,
            ) -> AnySpring<R> {
                $(
                    if *law == $law::LAW {
                        return AnySpring::$law($law::spring(values, corner));
                    }
                )*
                AnySpring::Linear(Linear::spring(&[R::splat(1.0); MAX_LAW_PARAMETERS], corner))
            }
        }

        macro_rules! of_law {
            ($dollar any:expr, $dollar spring:ident => $dollar code:expr) => {
                match $dollar any {
                    $(AnySpring::$law($dollar spring) => $dollar code,)*
                }
            };
        }
    };
}

laws! { $ Linear ThreeSlope Cubic }

impl<R: Real> Spring<R> for AnySpring<R> {
    type Shared = ();

    #[inline(always)]
    fn torque(&self, delta: R) -> R {
        of_law!(self, spring => spring.torque(delta))
    }

    #[inline(always)]
    fn stiffness(&self, delta: R) -> R {
        of_law!(self, spring => spring.stiffness(delta))
    }

    #[inline(always)]
    fn energy(&self, delta: R) -> R {
        of_law!(self, spring => spring.energy(delta))
    }

    fn least_stiffness(&self, torque: R) -> R {
        of_law!(self, spring => spring.least_stiffness(torque))
    }

    fn shared(&self) {}

    #[inline(always)]
    fn by_parameters(&self, delta: R, (): &()) -> [R; MAX_LAW_PARAMETERS] {
        of_law!(self, spring => spring.by_parameters(delta, &spring.shared()))
    }
}
