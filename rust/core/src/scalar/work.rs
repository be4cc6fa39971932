//! Work that is compiled as a function of its own, for the registers of a scalar.

use super::Real;

/// Work for [`Real::scope`]: a closure whose `run` can be forced inline.
pub trait Work {
    /// Result of the work.
    type Output;
    /// Runs the work. Implementations are `#[inline(always)]`.
    fn run(self) -> Self::Output;
}

/// Runs work in a separate function, so that long code that every stage of every step calls is
/// compiled once.
#[inline(never)]
pub(crate) fn run_out_of_line<R: Real, W: Work>(work: W) -> W::Output {
    R::scope(work)
}

/// Calls of functions as [`Work`]: the generics of the types, their names, and for each type its
/// fields, which are the arguments of a function.
macro_rules! works {
    (@ [$($generics:tt)*] [$($names:tt)*]
        $(#[$doc:meta])* $vis:vis $name:ident($($at:tt: $field:ty),*) -> $output:ty = $function:expr) => {
        $(#[$doc])*
        $vis struct $name<$($generics)*>($($vis $field),*);

        impl<$($generics)*> $crate::scalar::Work for $name<$($names)*> {
            type Output = $output;
            #[inline(always)]
            fn run(self) -> $output {
                $function($(self.$at),*)
            }
        }
    };
    ($generics:tt $names:tt
        $($(#[$doc:meta])* $vis:vis $name:ident $fields:tt -> $output:ty = $function:expr;)*) => {
        $($crate::scalar::works! {
            @ $generics $names $(#[$doc])* $vis $name $fields -> $output = $function
        })*
    };
}
pub(crate) use works;
