//! Elastic laws of gears: torque as a function of torsion, one law a file.
//!
//! To add a law, implement [`GearLaw`] and [`Spring`] for it in a file here and name it in the list
//! of [`laws`] below. The integrator, the events of friction, the sensitivities and the tests take
//! it as it is.

mod cubic;
mod laws;
mod linear;
mod three_slope;

pub use cubic::{Cubic, CubicSpring};
pub use laws::{AllLaws, AnySpring, Only, Slopes, SlopesSpring};
pub use linear::{Linear, LinearSpring};
pub use three_slope::{CORNER, ThreeSlope, ThreeSlopeSpring};

use crate::parameter::Parameter;
use crate::scalar::Real;

/// Most parameters that a law has.
pub const MOST_OF_A_LAW: usize = 7;

/// What all else knows of a law: its name and its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Law {
    /// As in a study file.
    pub name: &'static str,
    /// Its parameters, in the order of a flat list of values.
    pub parameters: &'static [Parameter],
    /// Of which of them each must be above the one before, as places: knees, say.
    pub rising: &'static [usize],
    /// Whether it gives way at all.
    pub elastic: bool,
}

impl PartialEq for Law {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// A gear that does not give way: motor and link move as one.
pub const RIGID: Law = Law {
    name: "rigid",
    parameters: &[],
    rising: &[],
    elastic: false,
};

/// The laws that the core knows.
pub fn known() -> Vec<Law> {
    let mut all = laws::ELASTIC.to_vec();
    all.push(RIGID);
    all
}

/// The law of a name.
pub fn law(name: &str) -> Option<Law> {
    known().into_iter().find(|law| law.name == name)
}

/// A law by which a gear gives way.
pub trait GearLaw: Copy + Send + Sync + 'static {
    /// Its name and parameters.
    const LAW: Law;
    /// A gear of this law.
    type Spring<R: Real>: Spring<R>;
    /// A gear with given values of the law's parameters; `corner` [rad] is the half width over
    /// which a law with knees rounds them.
    fn spring<R: Real>(values: &[R; MOST_OF_A_LAW], corner: f64) -> Self::Spring<R>;
}

/// A gear's elastic torque T(delta), odd in the torsion delta and rising. All methods that a step
/// of the integrator calls are `#[inline(always)]`.
pub trait Spring<R: Real>: Copy + Send + Sync {
    /// What the derivatives at every torsion share.
    type Shared: Copy;

    /// T(delta) [N m] at the link, `delta` in rad.
    fn torque(&self, delta: R) -> R;
    /// dT/ddelta [N m/rad].
    fn stiffness(&self, delta: R) -> R;
    /// Potential energy [J]: the integral of T from no torsion.
    fn energy(&self, delta: R) -> R;
    /// A lower bound [N m/rad] of T(delta)/delta up to the torsion at which it reaches `torque`.
    fn least_stiffness(&self, torque: R) -> R;
    /// See [`Spring::Shared`].
    fn shared(&self) -> Self::Shared;
    /// dT/dp at a torsion for each of the law's parameters p, in their order; zeros behind them.
    fn by_parameters(&self, delta: R, shared: &Self::Shared) -> [R; MOST_OF_A_LAW];

    /// The torsion [rad] at which the gear passes a torque [N m]: the inverse of
    /// [`Spring::torque`].
    ///
    /// Newton's iteration inside a bracket that is halved wherever a step leaves it or does not
    /// halve the excess: between a steep slope and a flat one the bare iteration can go round for
    /// ever.
    fn torsion(&self, torque: R) -> R {
        const { assert!(R::LANES == 1) };
        let wanted = torque.abs();
        let (mut low, mut high) = (R::splat(0.0), wanted / self.least_stiffness(wanted));
        let mut torsion = high;
        let mut excess = self.torque(torsion) - wanted;
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
            let mut left = self.torque(next) - wanted;
            let outside = (next - low).any_negative() || (high - next).any_negative();
            if outside || left.lane(0).abs() > 0.5 * excess.lane(0).abs() {
                next = R::splat(0.5) * (low + high);
                left = self.torque(next) - wanted;
            }
            (torsion, excess) = (next, left);
        }
        let torsion = R::root(torsion.lane(0), |torsion| self.torque(torsion) - wanted);
        torsion.copysign(torque)
    }
}

/// A set of laws that the gears of an arm may have, known at compile time.
///
/// The fewer there are the fewer branches stand in the innermost loop: [`Slopes`] has none,
/// [`AllLaws`] one a gear, and [`Only`] takes a law from outside of this crate.
pub trait Gears: Copy + Send + Sync + 'static {
    /// A gear of any of the laws.
    type Spring<R: Real>: Spring<R>;
    /// Whether a gear may be rigid as well.
    const RIGID: bool;
    /// Whether gears of a law are in this set.
    fn have(law: &Law) -> bool;
    /// A gear of a law with given values of its parameters; of a rigid one, any.
    fn spring<R: Real>(law: &Law, values: &[R; MOST_OF_A_LAW], corner: f64) -> Self::Spring<R>;
}
