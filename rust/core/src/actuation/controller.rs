//! What commands the voltages.
//!
//! To add a controller, implement [`Controller`] for it in a file here and name it in the list of
//! [`Servo`]. Derivatives through the loop follow from its equations over numbers with derivatives.

use super::{PiPosition, PiVelocity};
use crate::scalar::Real;

/// A controller of `N` joints, sampled at a fixed period.
pub trait Controller<const N: usize> {
    /// What it remembers from one reading to the next.
    type Memory<R: Real>: Clone;

    /// What it remembers if it has held the arm under a voltage [V] for long, its encoders reading
    /// these angles [rad].
    fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> Self::Memory<R>;

    /// Voltages [V] for the coming period, of a reading [rad] of the encoders, a reference as the
    /// controller has it, and what is added to the output [V]; for scalars of one lane.
    fn command<R: Real>(
        &self,
        memory: &mut Self::Memory<R>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N];

    /// Whether it drives a joint; all others get the feed-forward alone, at once.
    fn drives(&self, joint: usize) -> bool;
}

/// [`Servo`] and its memory.
macro_rules! controllers {
    ($($controller:ident)*) => {
        /// One of the controllers that the core knows.
        #[derive(Clone, Copy, Debug)]
        pub enum Servo<const N: usize> {
            $(
                #[doc = concat!("See [`", stringify!($controller), "`].")]
                $controller($controller<N>),
            )*
        }

        /// What one of them remembers.
        #[derive(Clone)]
        pub enum ServoMemory<R: Real, const N: usize> {
            $(
                #[doc = concat!("Of [`", stringify!($controller), "`].")]
                $controller(<$controller<N> as Controller<N>>::Memory<R>),
            )*
        }

        impl<const N: usize> Controller<N> for Servo<N> {
            type Memory<R: Real> = ServoMemory<R, N>;

            fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> ServoMemory<R, N> {
                match self {
                    $(Self::$controller(own) => {
                        ServoMemory::$controller(own.at_rest(voltage, encoder))
                    })*
                }
            }

            fn command<R: Real>(
                &self,
                memory: &mut ServoMemory<R, N>,
                reference: &[f64; N],
                encoder: &[R; N],
                feed_forward: &[f64; N],
            ) -> [R; N] {
                match (self, memory) {
                    $((Self::$controller(own), ServoMemory::$controller(memory)) => {
                        own.command(memory, reference, encoder, feed_forward)
                    })*
                    _ => unreachable!("a controller's memory is its own"),
                }
            }

            fn drives(&self, joint: usize) -> bool {
                match self {
                    $(Self::$controller(own) => own.drives(joint),)*
                }
            }
        }
    };
}

controllers! { PiVelocity PiPosition }
