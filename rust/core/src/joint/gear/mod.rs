//! Elastic laws of gears: torque as a function of torsion; one law per file.
//!
//! To add a law, implement [`GearLaw`] and [`Spring`] for it in a file here and name it in the list
//! of [`laws`] below. Integrator, friction events, sensitivities and tests use the list.

mod cubic;
mod laws;
mod linear;
mod three_slope;

pub use cubic::{Cubic, CubicSpring};
pub use laws::{AllLaws, AnySpring, SingleLaw, Slopes, SlopesSpring};
pub use linear::{Linear, LinearSpring};
pub use three_slope::{CORNER, ThreeSlope, ThreeSlopeSpring};

use crate::parameter::Parameter;
use crate::scalar::Real;

/// Largest number of parameters of a law.
pub const MAX_LAW_PARAMETERS: usize = 7;

/// Declaration of a law.
#[derive(Clone, Copy, Debug)]
pub struct Law {
    /// Name in study files.
    pub name: &'static str,
    /// Parameters in the order of a flat list of values.
    pub parameters: &'static [Parameter],
    /// Indices of parameters that must exceed the previous one, such as knees.
    pub rising: &'static [usize],
    /// Whether the gear is elastic.
    pub elastic: bool,
}

impl PartialEq for Law {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// A rigid gear: motor and link move together.
pub const RIGID: Law = Law {
    name: "rigid",
    parameters: &[],
    rising: &[],
    elastic: false,
};

/// Laws of the core.
pub fn all_laws() -> Vec<Law> {
    let mut all = laws::ELASTIC.to_vec();
    all.push(RIGID);
    all
}

/// The law with a name.
pub fn law(name: &str) -> Option<Law> {
    all_laws().into_iter().find(|law| law.name == name)
}

/// An elastic law of a gear.
pub trait GearLaw: Copy + Send + Sync + 'static {
    /// Declaration.
    const LAW: Law;
    /// A gear of this law.
    type Spring<R: Real>: Spring<R>;
    /// A gear with values of the law's parameters; `corner` [rad] is the half width of rounded
    /// knees.
    fn spring<R: Real>(values: &[R; MAX_LAW_PARAMETERS], corner: f64) -> Self::Spring<R>;
}

/// Elastic torque T(delta) of a gear, odd in the torsion delta and increasing. All methods that a
/// step of the integrator calls are `#[inline(always)]`.
pub trait Spring<R: Real>: Copy + Send + Sync {
    /// Terms of the derivatives that do not depend on the torsion.
    type Shared: Copy;

    /// T(delta) [N m] at the link, `delta` in rad.
    fn torque(&self, delta: R) -> R;
    /// dT/ddelta [N m/rad].
    fn stiffness(&self, delta: R) -> R;
    /// Potential energy [J]: the integral of T from zero torsion.
    fn energy(&self, delta: R) -> R;
    /// A lower bound [N m/rad] of T(delta)/delta for torques up to `torque`.
    fn least_stiffness(&self, torque: R) -> R;
    /// See [`Spring::Shared`].
    fn shared(&self) -> Self::Shared;
    /// dT/dp for each of the law's parameters p in order, followed by zeros.
    fn by_parameters(&self, delta: R, shared: &Self::Shared) -> [R; MAX_LAW_PARAMETERS];

    /// Torsion [rad] at a torque [N m]: the inverse of [`Spring::torque`].
    ///
    /// Newton's method within a bracket. A step that is outside the bracket or does not halve the
    /// residual is replaced by bisection, because Newton's method can cycle between a steep and a
    /// flat slope.
    fn torsion(&self, torque: R) -> R {
        const { assert!(R::LANES == 1) };
        let target = torque.abs();
        let (mut low, mut high) = (R::splat(0.0), target / self.least_stiffness(target));
        let mut torsion = high;
        let mut excess = self.torque(torsion) - target;
        for _ in 0..200 {
            if excess.any_negative() {
                low = torsion;
            } else {
                high = torsion;
            }
            let mut next = torsion - excess / self.stiffness(torsion);
            if (next - torsion).lane(0).abs() <= 1e-15 * next.lane(0) {
                break;
            }
            let mut next_excess = self.torque(next) - target;
            let outside = (next - low).any_negative() || (high - next).any_negative();
            if outside || next_excess.lane(0).abs() > 0.5 * excess.lane(0).abs() {
                next = (low + high) * 0.5;
                next_excess = self.torque(next) - target;
            }
            (torsion, excess) = (next, next_excess);
        }
        let torsion = R::root(torsion.lane(0), |torsion| self.torque(torsion) - target);
        torsion.copysign(torque)
    }
}

/// A set of laws for the gears of an arm, known at compile time.
///
/// Fewer laws need fewer branches in the innermost loop: [`Slopes`] has none, [`AllLaws`] one per
/// gear, and [`SingleLaw`] is a law from outside of this crate.
pub trait Gears: Copy + Send + Sync + 'static {
    /// A gear of any law of the set.
    type Spring<R: Real>: Spring<R>;
    /// Whether the set includes rigid gears.
    const RIGID: bool;
    /// Whether the set includes a law.
    fn includes(law: &Law) -> bool;
    /// A gear of a law with values of its parameters; any gear for a rigid one.
    fn spring<R: Real>(law: &Law, values: &[R; MAX_LAW_PARAMETERS], corner: f64)
    -> Self::Spring<R>;
}
