//! Lag of a drive beyond the current loop of the study.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{Parameter, TIME};
use crate::scalar::Real;

/// Limit of T/tau: at this value exp(-T/tau) is below rounding.
const MAX_TIME_RATIO: f64 = 40.0;

/// The effective voltage m follows the commanded u by tau dm/dt = u - m. Over a time T of constant
/// u its mean is u - (u - m) (tau/T) (1 - exp(-T/tau)), and its end u - (u - m) exp(-T/tau). Both
/// and their derivatives are regular at tau = 0.
#[derive(Clone, Copy, Debug)]
pub struct DriveLag<R> {
    /// tau [s].
    pub time_constant: R,
}

impl<R: Real> Effect<R> for DriveLag<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "drive-lag",
        parameters: &[Parameter::non_negative("drive_lag", "tau_u", TIME)
            .meaning("time constant in which the drive follows a voltage")],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            drive: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self {
            time_constant: values[0],
        }
    }

    #[inline(always)]
    fn hold_voltage(&self, voltage: R, memory: R, time: f64) -> [R; 2] {
        let divisor = self.time_constant.max(R::splat(time / MAX_TIME_RATIO));
        let decay = (R::splat(-time) / divisor).exp();
        let difference = voltage - memory;
        let share = self.time_constant * (1.0 / time) * (-decay + 1.0);
        [voltage - difference * share, voltage - difference * decay]
    }
}

#[cfg(test)]
mod tests;
