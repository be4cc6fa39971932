//! A gear that turns freely for a little.

use super::{Declared, Effect, Enters, MOST_OF_AN_EFFECT, NOWHERE};
use crate::parameter::{ANGLE, Parameter, Sign};
use crate::scalar::Real;

/// A dead band: the gear's spring feels the torsion beyond +-b. Its damping acts within it too.
#[derive(Clone, Copy, Debug)]
pub struct Backlash<R> {
    /// b [rad] at the link, half the band.
    pub half: R,
}

impl<R: Real> Effect<R> for Backlash<R> {
    const DECLARED: Declared = Declared {
        name: "backlash",
        parameters: &[Parameter::new(
            "backlash",
            "b_G",
            "half the dead band of the gear, at the link",
            ANGLE,
            Sign::NonNegative,
        )],
        sizes: 1,
        of_gear: true,
        enters: Enters {
            gear: true,
            ..NOWHERE
        },
    };

    fn of(values: &[R; MOST_OF_AN_EFFECT]) -> Self {
        Self { half: values[0] }
    }

    #[inline(always)]
    fn strain(&self, torsion: R) -> R {
        torsion - torsion.abs().min(self.half).copysign(torsion)
    }

    /// In the middle of the band where the spring feels nothing.
    fn torsion(&self, strain: R) -> R {
        if strain.lane(0) == 0.0 {
            strain
        } else {
            strain + self.half.copysign(strain)
        }
    }
}
