//! A chain of rigid links on revolute or prismatic joints placed anywhere in space.

mod kinematics;
mod placement;
mod posture;
mod recursion;
mod spatial;
mod vector;

pub use kinematics::Kinematics;
pub use placement::{ChainJoint, JointType};
pub use posture::Posture;

use super::link_signals::{LINK_SIGNALS, of_link};
use super::{Arm, Name, Outlined, Slopes, Transmission, first_joints};
use crate::parameter::Parameter;
use crate::scalar::{Real, Work, run_out_of_line, symmetrise, works};
use placement::{JointPosture, Placement};
use posture::{Placements, ROOM, Rows, zeros};
use std::f64::consts::TAU;
use vector::{cross, dot, plus, scaled, splat, times};

/// Largest number of joints of a chain, for which programs are compiled.
pub const MAX_CHAIN_JOINTS: usize = 7;

/// Number of inertial parameters of a link.
const LINK_PARAMETER_COUNT: usize = 10;

/// kg m of revolute and prismatic joints.
const FIRST_MOMENT: [&str; 2] = ["kg m"; 2];
/// kg m^2 of both.
const SECOND_MOMENT: [&str; 2] = ["kg m^2"; 2];

/// Names of the inertial parameters: mass m [kg], first moments m c [kg m] and inertia [kg m^2]
/// about the origin of the link's frame, along its axes.
const LINK_PARAMETERS: [Parameter; LINK_PARAMETER_COUNT] = [
    Parameter::positive("link_mass", "m", ["kg"; 2]).meaning("mass of the link"),
    Parameter::any("link_first_moment_x", "m c", FIRST_MOMENT)
        .meaning("mass of the link times its centre's x in the link's frame"),
    Parameter::any("link_first_moment_y", "m c", FIRST_MOMENT)
        .meaning("mass of the link times its centre's y in the link's frame"),
    Parameter::any("link_first_moment_z", "m c", FIRST_MOMENT)
        .meaning("mass of the link times its centre's z in the link's frame"),
    Parameter::positive("link_inertia_xx", "I", SECOND_MOMENT)
        .meaning("xx entry of the link's inertia about its frame's origin"),
    Parameter::any("link_inertia_xy", "I", SECOND_MOMENT)
        .meaning("xy entry of the link's inertia about its frame's origin"),
    Parameter::positive("link_inertia_yy", "I", SECOND_MOMENT)
        .meaning("yy entry of the link's inertia about its frame's origin"),
    Parameter::any("link_inertia_xz", "I", SECOND_MOMENT)
        .meaning("xz entry of the link's inertia about its frame's origin"),
    Parameter::any("link_inertia_yz", "I", SECOND_MOMENT)
        .meaning("yz entry of the link's inertia about its frame's origin"),
    Parameter::positive("link_inertia_zz", "I", SECOND_MOMENT)
        .meaning("zz entry of the link's inertia about its frame's origin"),
];

/// A chain of at most `N` links on a fixed base; of exactly `N` links, if its length is `KNOWN`.
///
/// Torques follow from the recursion of Newton and Euler; they are linear in ten parameters per
/// link, all of which are parameters of the arm, identifiable or not. The inertia matrix follows
/// from composite rigid bodies.
///
/// The accelerometer of a link is at `accelerometer_distance` across the joint's axis, along the
/// projection of the frame's x axis (of its y axis if the joint's axis is x), and reads
/// perpendicular to both. On a prismatic joint it is at the link's origin and reads along the
/// axis. A gyro reads the rate about the axis.
///
/// Derivatives of torques with respect to the motion are in closed form; those of sensors follow
/// from the recursion over [`crate::scalar::Jet`]s.
#[derive(Clone, Copy, Debug)]
pub struct SerialChain<const N: usize, const KNOWN: bool = false> {
    /// The joints; unused entries repeat the first.
    joints: [Placement; N],
    placements: Placements,
    count: usize,
    /// [m/s^2] in the base frame.
    gravity: [f64; 3],
    transmission: Option<Transmission<N>>,
}

impl<const N: usize, const KNOWN: bool> SerialChain<N, KNOWN> {
    /// Joints from the base, and the acceleration of gravity [m/s^2] in the base frame.
    ///
    /// # Errors
    /// The index of the first joint whose axis has length zero.
    ///
    /// # Panics
    /// There are no joints, or more than `N`.
    pub fn new(joints: &[ChainJoint], gravity: [f64; 3]) -> Result<Self, usize> {
        let placed = |i: usize| Placement::new(&joints[i]).ok_or(i);
        let mut all = [placed(0)?; N];
        for i in 1..joints.len() {
            all[i] = placed(i)?;
        }
        Ok(Self {
            joints: all,
            placements: Placements::new(&all[..joints.len()]),
            count: joints.len(),
            gravity,
            transmission: None,
        })
    }

    /// The same chain with a transmission between motors and joints.
    pub fn with_transmission(self, transmission: Transmission<N>) -> Self {
        Self {
            transmission: Some(transmission),
            ..self
        }
    }

    /// The same chain with its number of joints known to the compiler.
    ///
    /// # Panics
    /// The chain has another number of joints.
    pub fn with_known_length<const LENGTH: usize>(&self) -> SerialChain<LENGTH, true> {
        assert_eq!(LENGTH, self.count);
        let transmission = self.transmission.as_ref();
        SerialChain {
            joints: first_joints(&self.joints),
            placements: self.placements,
            count: self.count,
            gravity: self.gravity,
            transmission: transmission.map(Transmission::of_first_joints),
        }
    }

    /// A planar arm whose gravity [m/s^2] acts against y.
    pub(super) fn planar(joints: &[ChainJoint], gravity: f64) -> Self {
        Self::new(joints, [0.0, -gravity, 0.0]).expect("every axis has a direction")
    }
}

/// Inertial parameters of the links.
type Bodies<R> = Rows<R, LINK_PARAMETER_COUNT>;

/// Torques per inertial parameter, link by link, and the number of links.
pub struct Regressor<R, const N: usize>([[[R; N]; LINK_PARAMETER_COUNT]; N], usize);

impl<R, const N: usize> AsRef<[[R; N]]> for Regressor<R, N> {
    #[inline(always)]
    fn as_ref(&self) -> &[[R; N]] {
        self.0[..self.1].as_flattened()
    }
}

impl<const N: usize, const KNOWN: bool> Arm<N> for SerialChain<N, KNOWN> {
    type Base<R: Real> = Bodies<R>;
    type Posture<R: Real> = Posture<R>;
    type Regressor<R: Real> = Regressor<R, N>;

    const DEPENDS_ON_ANGLE: [bool; N] = [true; N];
    const PLANAR: bool = false;
    const PARAMETERS: &'static [Parameter] = &LINK_PARAMETERS;
    const OUTLINED: Outlined = if KNOWN {
        Outlined::Stages
    } else {
        Outlined::Parts
    };

    #[inline(always)]
    fn joints(&self) -> usize {
        if KNOWN { N } else { self.count }
    }

    fn names(&self) -> Vec<Name> {
        let of = |i: usize| LINK_PARAMETERS.map(|parameter| (parameter.name, Some(i + 1)));
        (0..self.count).flat_map(of).collect()
    }

    /// The links need not be bodies: motion determines combinations of their parameters, and one
    /// set that has them stands for all others. The inertia matrix is positive definite in postures
    /// all over the workspace.
    fn check(
        &self,
        values: &[f64],
        reflected: &[Option<f64>; N],
    ) -> Result<(), (usize, &'static str)> {
        let bodies = values.chunks(LINK_PARAMETER_COUNT).take(self.count);
        if let Some(i) = bodies.into_iter().position(|body| body[0] <= 0.0) {
            return Err((i * LINK_PARAMETER_COUNT, "positive"));
        }
        let base = self.base(values);
        for k in 0..CHECKED_POSTURES {
            let angle = |i: usize| TAU * (GOLDEN_RATIO * (k * (i + 1)) as f64).fract();
            let at = self.posture(&std::array::from_fn(angle));
            let mut inertia = self.inertia(&base, &at);
            for i in 0..N {
                inertia[i][i] += reflected[i].unwrap_or(0.0);
            }
            if let Some(i) = improper_joint(inertia, self.count) {
                let must = "such that the inertia matrix is positive definite in every posture";
                return Err((i * LINK_PARAMETER_COUNT + 4, must));
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn base<R: Real>(&self, values: &[R]) -> Bodies<R> {
        let mut all = zeros();
        for i in 0..self.count {
            for k in 0..LINK_PARAMETER_COUNT {
                all[k][i] = values[i * LINK_PARAMETER_COUNT + k];
            }
        }
        all
    }

    #[inline(always)]
    fn map_base<R: Real, L: Real>(base: &Bodies<R>, to: impl Fn(R) -> L) -> Bodies<L> {
        let mut all = zeros();
        for k in 0..LINK_PARAMETER_COUNT {
            for i in 0..ROOM {
                all[k][i] = to(base[k][i]);
            }
        }
        all
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; N]) -> Posture<R> {
        self.posture_at(q)
    }

    #[inline(always)]
    fn near<R: Real>(&self, from: &Posture<R>, increment: &[R; N]) -> Posture<R> {
        self.posture_near(from, increment)
    }

    #[inline(always)]
    fn map_posture<R: Real, L: Real>(at: &Posture<R>, to: impl Fn(R) -> L) -> Posture<L> {
        at.map(to)
    }

    fn chain(&self) -> SerialChain<N> {
        SerialChain {
            joints: self.joints,
            placements: self.placements,
            count: self.count,
            gravity: self.gravity,
            transmission: self.transmission,
        }
    }

    #[inline(always)]
    fn transmission(&self) -> Option<&Transmission<N>> {
        self.transmission.as_ref()
    }

    #[inline(always)]
    fn inertia<R: Real>(&self, base: &Bodies<R>, at: &Posture<R>) -> [[R; N]; N] {
        let mut inertia = self.equations(base, at, &[R::splat(0.0); N]).0;
        symmetrise(&mut inertia);
        inertia
    }

    #[inline(always)]
    fn bias<R: Real>(&self, base: &Bodies<R>, at: &Posture<R>, dq: &[R; N]) -> [R; N] {
        self.equations(base, at, dq).1
    }

    #[inline(always)]
    fn equations<R: Real>(
        &self,
        base: &Bodies<R>,
        at: &Posture<R>,
        dq: &[R; N],
    ) -> ([[R; N]; N], [R; N]) {
        equation::<R, _, KNOWN>(Dynamics(self, base, at, dq, &[R::splat(0.0); N]))
    }

    #[inline(always)]
    fn torques<R: Real>(
        &self,
        base: &Bodies<R>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N] {
        equation::<R, _, KNOWN>(Dynamics(self, base, at, dq, ddq)).1
    }

    #[inline(always)]
    fn slopes<R: Real>(
        &self,
        base: &Bodies<R>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> Slopes<R, N> {
        self.linearised_equations(base, at, dq, ddq).1
    }

    #[inline(always)]
    fn linearised_equations<R: Real>(
        &self,
        base: &Bodies<R>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> ([[R; N]; N], Slopes<R, N>) {
        equation::<R, _, KNOWN>(Linearised(self, base, at, dq, ddq))
    }

    #[inline(always)]
    fn regressor<R: Real>(&self, at: &Posture<R>, dq: &[R; N], ddq: &[R; N]) -> Regressor<R, N> {
        let mut regressor = self.zero_regressor();
        self.update_regressor(at, dq, ddq, &mut regressor);
        regressor
    }

    #[inline(always)]
    fn zero_regressor<R: Real>(&self) -> Regressor<R, N> {
        let zero = R::splat(0.0);
        Regressor([[[zero; N]; LINK_PARAMETER_COUNT]; N], self.joints())
    }

    #[inline(always)]
    fn update_regressor<R: Real>(
        &self,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
        regressor: &mut Regressor<R, N>,
    ) {
        equation::<R, _, KNOWN>(PerParameter(self, at, dq, ddq, &mut regressor.0));
    }

    /// A joint carries its link and those behind it.
    #[inline(always)]
    fn first_parameter(&self, joint: usize) -> usize {
        joint * LINK_PARAMETER_COUNT
    }

    fn potential<R: Real>(&self, base: &Bodies<R>, at: &Posture<R>) -> R {
        // mass and first moment of all links from the i-th, about its origin
        let (mut mass, mut moment) = (R::splat(0.0), [R::splat(0.0); 3]);
        for i in (0..self.count).rev() {
            mass = mass + base[0][i];
            let JointPosture { rotation, origin } = self.joint_at(at, i);
            let own = [base[1][i], base[2][i], base[3][i]];
            let rotated = times(&rotation, &plus(&moment, &own));
            moment = scaled(mass, &origin, &rotated);
        }
        -dot(&splat(&self.gravity), &moment)
    }

    #[inline(always)]
    fn accelerometers<R: Real>(&self, at: &Posture<R>, dq: &[R; N], ddq: &[R; N]) -> [R; N] {
        let mut reading = [R::splat(0.0); N];
        for (i, motion) in equation::<R, _, KNOWN>(Motions(self, at, dq, ddq))
            .iter()
            .enumerate()
            .take(self.count)
        {
            let placed = &self.joints[i];
            reading[i] = if placed.is_revolute() {
                let zero = [R::splat(0.0); 3];
                let distance = R::splat(placed.accelerometer_distance);
                let position = scaled(distance, &splat(&placed.x), &zero);
                let tangential = cross(&motion.turning, &position);
                let inward = cross(&motion.rate, &cross(&motion.rate, &position));
                dot(
                    &splat(&placed.y),
                    &plus(&motion.force, &plus(&tangential, &inward)),
                )
            } else {
                dot(&splat(&placed.axis), &motion.force)
            };
        }
        reading
    }

    #[inline(always)]
    fn absolute_rates<R: Real>(&self, at: &Posture<R>, dq: &[R; N]) -> [R; N] {
        let mut rates = *dq;
        for (i, motion) in equation::<R, _, KNOWN>(Motions(self, at, dq, dq))
            .iter()
            .enumerate()
            .take(self.count)
        {
            rates[i] = dot(&splat(&self.joints[i].axis), &motion.rate);
        }
        rates
    }

    #[inline(always)]
    fn link_signals<R: Real>(
        &self,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [[R; N]; LINK_SIGNALS] {
        let mut all = [[R::splat(0.0); N]; LINK_SIGNALS];
        for (i, motion) in equation::<R, _, KNOWN>(Motions(self, at, dq, ddq))
            .iter()
            .enumerate()
            .take(self.count)
        {
            let signals = of_link([motion.force, motion.turning, motion.rate]);
            for k in 0..LINK_SIGNALS {
                all[k][i] = signals[k];
            }
        }
        all
    }
}

/// Postures in which the inertia matrix is checked; the first has all angles zero.
const CHECKED_POSTURES: usize = 16;
/// Its multiples modulo one are spread evenly.
const GOLDEN_RATIO: f64 = 1.618_033_988_749_895;

/// The joint, from 0, next to the end of the chain that can be accelerated without inertia while
/// the joints before it are held.
fn improper_joint<const N: usize>(mut inertia: [[f64; N]; N], joints: usize) -> Option<usize> {
    for j in (0..joints).rev() {
        let pivot = inertia[j][j];
        if pivot.is_nan() || pivot <= 0.0 {
            return Some(j);
        }
        for i in 0..j {
            for k in 0..j {
                inertia[i][k] -= inertia[i][j] * inertia[j][k] / pivot;
            }
        }
    }
    None
}

/// Runs work, in a separate function unless the length of the chain is known and the work is
/// frequent.
#[inline(always)]
fn equation<R: Real, W: Work, const KNOWN: bool>(work: W) -> W::Output {
    if KNOWN && !R::HAS_DERIVATIVE {
        work.run()
    } else {
        run_out_of_line::<R, _>(work)
    }
}

// Recursions compiled as separate functions, because every stage of every step calls them: inlined,
// those of six links would be most of the program.
works! {
    ['a, R: Real, const N: usize, const KNOWN: bool] ['a, R, N, KNOWN]
    /// [`SerialChain::dynamics`].
    Dynamics(0: &'a SerialChain<N, KNOWN>, 1: &'a Bodies<R>, 2: &'a Posture<R>, 3: &'a [R; N], 4: &'a [R; N])
        -> ([[R; N]; N], [R; N]) = SerialChain::dynamics;
    /// [`SerialChain::linearised`].
    Linearised(0: &'a SerialChain<N, KNOWN>, 1: &'a Bodies<R>, 2: &'a Posture<R>, 3: &'a [R; N], 4: &'a [R; N])
        -> ([[R; N]; N], Slopes<R, N>) = SerialChain::linearised;
    /// [`SerialChain::motions`].
    Motions(0: &'a SerialChain<N, KNOWN>, 1: &'a Posture<R>, 2: &'a [R; N], 3: &'a [R; N])
        -> [recursion::LinkMotion<R>; N] = SerialChain::motions;
    /// [`SerialChain::set_torques_per_parameter`].
    PerParameter(0: &'a SerialChain<N, KNOWN>, 1: &'a Posture<R>, 2: &'a [R; N], 3: &'a [R; N],
        4: &'a mut [[[R; N]; LINK_PARAMETER_COUNT]; N]) -> () = SerialChain::set_torques_per_parameter;
}

#[cfg(test)]
mod tests;
