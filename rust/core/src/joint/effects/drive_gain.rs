//! Gain error of a drive.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign};
use crate::scalar::Real;

/// The effective voltage is u (1 + g).
#[derive(Clone, Copy, Debug)]
pub struct DriveGain<R> {
    /// g.
    pub more: R,
}

impl<R: Real> Effect<R> for DriveGain<R> {
    const DECLARED: Declared = Declared {
        name: "drive-gain",
        parameters: &[Parameter::new(
            "drive_gain",
            "g_u",
            "relative error of the torque per volt",
            ["1", "1"],
            Sign::Any,
        )],
        sizes: 1,
        of_gear: false,
        enters: Enters {
            drive: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self { more: values[0] }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        self.more.mul_add(voltage, voltage)
    }
}
