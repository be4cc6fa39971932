//! Controllers, which command the voltages.
//!
//! To add a controller, implement [`Controller`] for it in a file here and name it in the list of
//! [`Servo`]. Derivatives through the loop follow from its equations over dual numbers.

use super::{LinearServo, PiPosition, PiVelocity};
use crate::scalar::Real;

/// A controller of `N` joints, sampled at a fixed period.
pub trait Controller<const N: usize> {
    /// State between two readings.
    type Memory<R: Real>: Clone;

    /// Steady state of the controller at a voltage [V], with encoder
    /// readings [rad].
    fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> Self::Memory<R>;

    /// Voltages [V] for the coming period from encoder readings [rad], a reference and a
    /// feed-forward voltage [V]; for scalars of one lane.
    fn command<R: Real>(
        &self,
        memory: &mut Self::Memory<R>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N];

    /// Whether it controls a joint. Other joints get the feed-forward alone, without sampling.
    fn drives(&self, joint: usize) -> bool;
}

/// [`Servo`] and its state.
macro_rules! controllers {
    ($($controller:ident)*) => {
        /// The controllers of the core.
        #[derive(Clone, Debug)]
        pub enum Servo<const N: usize> {
            $(
                #[doc = concat!("See [`", stringify!($controller), "`].")]
                $controller($controller<N>),
            )*
        }

        /// State of a [`Servo`].
        #[derive(Clone)]
        pub enum ServoMemory<R: Real, const N: usize> {
            $(
                #[doc = concat!("Of [`", stringify!($controller), "`].")]
                $controller(<$controller<N> as Controller<N>>::Memory<R>),
            )*
        }

        impl<const N: usize> Servo<N> {
            /// The controller of the first joints.
            pub(crate) fn of_first_joints<const M: usize>(&self) -> Servo<M> {
                match self {
                    $(Self::$controller(controller) => Servo::$controller(controller.of_first_joints()),)*
                }
            }
        }

        impl<const N: usize> Controller<N> for Servo<N> {
            type Memory<R: Real> = ServoMemory<R, N>;

            fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> ServoMemory<R, N> {
                match self {
                    $(Self::$controller(controller) => {
                        ServoMemory::$controller(controller.at_rest(voltage, encoder))
                    })*
                }
            }

            #[inline(always)]
            fn command<R: Real>(
                &self,
                memory: &mut ServoMemory<R, N>,
                reference: &[f64; N],
                encoder: &[R; N],
                feed_forward: &[f64; N],
            ) -> [R; N] {
                match (self, memory) {
                    $((Self::$controller(controller), ServoMemory::$controller(memory)) => {
                        controller.command(memory, reference, encoder, feed_forward)
                    })*
                    _ => unreachable!("the memory belongs to another controller"),
                }
            }

            fn drives(&self, joint: usize) -> bool {
                match self {
                    $(Self::$controller(controller) => controller.drives(joint),)*
                }
            }
        }
    };
}

controllers! { PiVelocity PiPosition LinearServo }
