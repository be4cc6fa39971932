//! Dead zone of a drive: small commands have no effect.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{Parameter, VOLTAGE};
use crate::scalar::Real;

/// Smallest smoothing width [V]: far below any dead zone, and far above the rounding of a voltage
/// of zero, whose sign would otherwise determine the derivative of a dead zone of zero.
const MIN_SMOOTHING_WIDTH: f64 = 1e-9;

/// The effective voltage is u - d u / max(|u|, d, r), with r = [`MIN_SMOOTHING_WIDTH`]: zero within
/// +-d, and smaller by d beyond.
#[derive(Clone, Copy, Debug)]
pub struct DeadZone<R> {
    /// d [V], half the width.
    pub half: R,
}

impl<R: Real> Effect<R> for DeadZone<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "dead-zone",
        parameters: &[Parameter::non_negative("dead_zone", "u_0", VOLTAGE)
            .meaning("half the dead zone of the drive")],
        sizes: 1,
        of_gear: false,
        affects: AffectedTerms {
            drive: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self { half: values[0] }
    }

    #[inline(always)]
    fn drive(&self, voltage: R) -> R {
        let widest = voltage
            .abs()
            .max(self.half)
            .max(R::splat(MIN_SMOOTHING_WIDTH));
        voltage - self.half * voltage / widest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Jet;

    #[test]
    fn voltage_within_the_zone_is_zero() {
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
    fn zero_width_derivative_is_insensitive_to_rounding() {
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
