//! Saturation of a motor: its torque constant decreases with current.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::Parameter;
use crate::scalar::Real;

/// The effective voltage is u (1 - s |u|).
#[derive(Clone, Copy, Debug)]
pub struct DriveSaturation<R> {
    /// s [1/V].
    pub per_volt: R,
}

impl<R: Real> Effect<R> for DriveSaturation<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "drive-saturation",
        parameters: &[
            Parameter::non_negative("drive_saturation", "s_u", ["1/V", "1/V"])
                .meaning("share of the torque per volt that is lost per volt"),
        ],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            drive: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            per_volt: values[0],
        }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        voltage - self.per_volt * voltage * voltage.abs()
    }
}
