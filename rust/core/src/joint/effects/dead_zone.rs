//! Dead zone of a drive: small commands have no effect.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{Parameter, Sign, VOLTAGE};
use crate::scalar::Real;

/// Smallest smoothing width [V]: far below any dead zone, and far above the rounding of a voltage
/// of zero, whose sign would otherwise determine the derivative of a dead zone of zero.
const LEAST: f64 = 1e-9;

/// The effective voltage is u - d u / max(|u|, d, r), with r = [`LEAST`]: zero within +-d, and
/// smaller by d beyond.
#[derive(Clone, Copy, Debug)]
pub struct DeadZone<R> {
    /// d [V], half the width.
    pub half: R,
}

impl<R: Real> Effect<R> for DeadZone<R> {
    const DECLARED: Declared = Declared {
        name: "dead-zone",
        parameters: &[Parameter::new(
            "dead_zone",
            "u_0",
            "half the dead zone of the drive",
            VOLTAGE,
            Sign::NonNegative,
        )],
        sizes: 1,
        of_gear: false,
        enters: Enters {
            drive: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self { half: values[0] }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        let widest = voltage.abs().max(self.half).max(R::splat(LEAST));
        voltage - self.half * voltage / widest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Jet;

    #[test]
    fn what_is_within_the_zone_moves_nothing() {
        let zone = DeadZone { half: 0.5 };
        for (voltage, expected) in [
            (0.0, 0.0),
            (0.3, 0.0),
            (-0.3, 0.0),
            (2.0, 1.5),
            (-2.0, -1.5),
        ] {
            assert!((zone.drive(voltage) - expected).abs() < 1e-15, "{voltage}");
        }
    }

    #[test]
    fn a_zone_of_no_width_takes_nothing_from_a_voltage_of_rounding() {
        let zone = DeadZone {
            half: Jet {
                value: 0.0,
                tangent: 1.0,
            },
        };
        assert!(zone.drive(Jet::constant(-1e-17)).tangent.abs() < 1e-7);
        assert_eq!(zone.drive(Jet::constant(-3.0)).tangent, 1.0);
        assert_eq!(zone.drive(Jet::constant(-3.0)).value, -3.0);
    }
}
