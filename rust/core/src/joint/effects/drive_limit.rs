//! Limit of an amplifier at large voltages.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign, VOLTAGE};
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
    const DECLARED: Declared = Declared {
        name: "drive-limit",
        parameters: &[
            Parameter::new(
                "drive_limit_loss",
                "c_u",
                "share that the drive loses of a voltage beyond its limit",
                ["1", "1"],
                Sign::NonNegative,
            ),
            Parameter::new(
                "drive_limit",
                "u_L",
                "voltage beyond which the drive gives less",
                VOLTAGE,
                Sign::Positive,
            ),
        ],
        sizes: 1,
        of_gear: false,
        enters: Enters {
            drive: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
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
    fn nothing_is_lost_within_the_limit() {
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
    fn a_little_loss_takes_what_is_beyond() {
        let drive = DriveLimit {
            loss: Jet {
                value: 0.0,
                tangent: 1.0,
            },
            limit: Jet::constant(6.0),
        };
        for (voltage, expected) in [(5.0, 0.0), (8.0, -2.0), (-9.0, 3.0)] {
            let driven = drive.drive(Jet::constant(voltage));
            assert_eq!((driven.value, driven.tangent), (voltage, expected));
        }
    }
}
