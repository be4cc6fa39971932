//! Backlash: the gear turns freely over a small angle.

use super::{AffectedTerms, Effect, EffectDeclaration, MAX_EFFECT_PARAMETERS, NO_TERMS};
use crate::parameter::{ANGLE, Parameter};
use crate::scalar::Real;

/// Smallest smoothing width [rad]: far below any backlash, and far above the rounding of a torsion
/// of zero, whose sign would otherwise determine the derivative of a backlash of zero.
const MIN_SMOOTHING_WIDTH: f64 = 1e-8;

/// A dead band of the gear's spring at torsions within +-b. The damping acts within the band too.
///
/// The strain is delta - b delta / max(|delta|, b, r), with r = [`MIN_SMOOTHING_WIDTH`]: sharp for
/// bands wider than r.
#[derive(Clone, Copy, Debug)]
pub struct Backlash<R> {
    /// b [rad] at the link, half the width.
    pub half: R,
}

impl<R: Real> Effect<R> for Backlash<R> {
    const DECLARATION: EffectDeclaration = EffectDeclaration {
        name: "backlash",
        parameters: &[Parameter::non_negative("backlash", "b_G", ANGLE)
            .meaning("half the dead band of the gear, at the link")],
        sizes: 1,
        of_gear: true,
        affects: AffectedTerms {
            gear: true,
            ..NO_TERMS
        },
    };

    fn of(values: &[R; MAX_EFFECT_PARAMETERS]) -> Self {
        Self { half: values[0] }
    }

    #[inline(always)]
    fn strain(&self, torsion: R) -> R {
        let widest = torsion
            .abs()
            .max(self.half)
            .max(R::splat(MIN_SMOOTHING_WIDTH));
        torsion - self.half * torsion / widest
    }

    /// The middle of the dead band at zero strain; approximate for strains below
    /// [`MIN_SMOOTHING_WIDTH`].
    fn torsion(&self, strain: R) -> R {
        strain + self.half * strain / strain.abs().max(R::splat(MIN_SMOOTHING_WIDTH))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Jet;

    fn strain_by_band(torsion: f64, half: f64) -> Jet<f64> {
        let moving = Jet {
            value: half,
            tangent: 1.0,
        };
        Backlash { half: moving }.strain(Jet::constant(torsion))
    }

    #[test]
    fn strain_is_torsion_beyond_the_band() {
        let gear = Backlash { half: 2e-4 };
        for (torsion, expected) in [(5e-4, 3e-4), (-5e-4, -3e-4), (1e-4, 0.0), (0.0, 0.0)] {
            assert!((gear.strain(torsion) - expected).abs() < 1e-15, "{torsion}");
        }
        for strain in [0.0, 1e-5, -3e-4] {
            assert!((gear.strain(gear.torsion(strain)) - strain).abs() < 1e-15);
        }
    }

    #[test]
    fn zero_width_derivative_is_insensitive_to_rounding() {
        assert!(strain_by_band(1e-17, 0.0).tangent.abs() < 1e-8);
        assert!((strain_by_band(-1e-5, 0.0).tangent - 1.0).abs() < 1e-5);
        assert_eq!(strain_by_band(3e-4, 0.0).value, 3e-4);
    }
}
