//! Gain error of a drive.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{NO_UNIT, Parameter};
use crate::scalar::Real;

/// The effective voltage is u (1 + g).
#[derive(Clone, Copy, Debug)]
pub struct DriveGain<R> {
    /// g.
    pub more: R,
}

impl<R: Real> Effect<R> for DriveGain<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "drive-gain",
        parameters: &[Parameter::any("drive_gain", "g_u", NO_UNIT)
            .meaning("relative error of the torque per volt")],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            drive: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self { more: values[0] }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        self.more.mul_add(voltage, voltage)
    }
}
