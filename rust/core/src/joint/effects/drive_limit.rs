//! Limit of an amplifier at large voltages.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{NO_UNIT, Parameter, VOLTAGE};
use crate::scalar::Real;

/// The effective voltage is u - c sgn(u) max(|u| - L, 0): a share c of the voltage beyond L is
/// lost.
#[derive(Clone, Copy, Debug)]
pub struct DriveLimit<R> {
    /// c.
    pub loss: R,
    /// L [V].
    pub limit: R,
}

impl<R: Real> Effect<R> for DriveLimit<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "drive-limit",
        parameters: &[
            Parameter::non_negative("drive_limit_loss", "c_u", NO_UNIT)
                .meaning("share of the voltage above the limit that the drive loses"),
            Parameter::positive("drive_limit", "u_L", VOLTAGE)
                .meaning("voltage above which the drive output is reduced"),
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
            loss: values[0],
            limit: values[1],
        }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        let beyond = (voltage.abs() - self.limit).max(R::splat(0.0));
        voltage - self.loss * beyond.copysign(voltage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Jet;

    #[test]
    fn voltage_within_the_limit_is_unchanged() {
        let drive = DriveLimit {
            loss: 0.25,
            limit: 6.0,
        };
        for (voltage, expected) in [
            (0.0, 0.0),
            (5.0, 5.0),
            (-6.0, -6.0),
            (8.0, 7.5),
            (-10.0, -9.0),
        ] {
            assert_eq!(drive.drive(voltage), expected);
        }
    }

    #[test]
    fn derivative_at_zero_loss_is_excess() {
        let drive = DriveLimit {
            loss: Jet {
                value: 0.0,
                tangent: 1.0,
            },
            limit: Jet::constant(6.0),
        };
        for (voltage, expected) in [(5.0, 0.0), (8.0, -2.0), (-9.0, 3.0)] {
            let effective = drive.drive(Jet::constant(voltage));
            assert_eq!((effective.value, effective.tangent), (voltage, expected));
        }
    }
}
