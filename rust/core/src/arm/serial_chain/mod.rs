//! A chain of rigid links on revolute or prismatic joints placed anywhere in space.

mod kinematics;
mod placement;
mod recursion;
mod vector;

pub use kinematics::Kinematics;
pub use placement::{ChainJoint, JointPosture, JointType};

use super::link_signals::{LINK_SIGNALS, of_link};
use super::{Arm, Name, Transmission};
use crate::parameter::{Parameter, Sign};
use crate::scalar::{Real, Work, run_out_of_line};
use placement::Placement;
use vector::{cross, dot, plus, scaled, splat, times};

/// Number of inertial parameters of a link.
const LINK_PARAMETER_COUNT: usize = 10;

/// m c along an axis of the link's frame.
macro_rules! first_moment {
    ($axis:literal) => {
        Parameter::new(
            concat!("link_first_moment_", $axis),
            "m c",
            concat!(
                "mass of the link times its centre's ",
                $axis,
                " in the link's frame"
            ),
            ["kg m"; 2],
            Sign::Any,
        )
    };
}

/// An entry of the link's inertia.
macro_rules! inertia {
    ($entry:literal, $sign:ident) => {
        Parameter::new(
            concat!("link_inertia_", $entry),
            "I",
            concat!(
                $entry,
                " entry of the link's inertia about its frame's origin"
            ),
            ["kg m^2"; 2],
            Sign::$sign,
        )
    };
}

/// Names of the inertial parameters: mass m [kg], first moments m c [kg m] and inertia [kg m^2]
/// about the origin of the link's frame, along its axes.
const LINK_PARAMETERS: [Parameter; LINK_PARAMETER_COUNT] = [
    Parameter::new(
        "link_mass",
        "m",
        "mass of the link",
        ["kg"; 2],
        Sign::Positive,
    ),
    first_moment!("x"),
    first_moment!("y"),
    first_moment!("z"),
    inertia!("xx", Positive),
    inertia!("xy", Any),
    inertia!("yy", Positive),
    inertia!("xz", Any),
    inertia!("yz", Any),
    inertia!("zz", Positive),
];

/// A chain of `N` links on a fixed base.
///
/// Torques follow from the recursion of Newton and Euler; they are linear in ten parameters per
/// link, all of which are parameters of the arm, identifiable or not. The inertia matrix is the sum
/// over the links (composite rigid bodies).
///
/// The accelerometer of a link is at `accelerometer_distance` across the joint's axis, along the
/// projection of the frame's x axis (of its y axis if the joint's axis is x), and reads
/// perpendicular to both. On a prismatic joint it is at the link's origin and reads along the
/// axis. A gyro reads the rate about the axis.
///
/// Derivatives with respect to the motion follow from the recursion over [`crate::scalar::Jet`]s.
#[derive(Clone, Copy, Debug)]
pub struct SerialChain<const N: usize> {
    joints: [Placement; N],
    /// [m/s^2] in the base frame.
    gravity: [f64; 3],
    transmission: Option<Transmission<N>>,
}

impl<const N: usize> SerialChain<N> {
    /// Joints from the base, and the acceleration of gravity [m/s^2] in the base frame.
    ///
    /// # Errors
    /// The index of the first joint whose axis has length zero.
    pub fn new(joints: &[ChainJoint; N], gravity: [f64; 3]) -> Result<Self, usize> {
        let placed = joints.each_ref().map(Placement::new);
        if let Some(index) = placed.iter().position(Option::is_none) {
            return Err(index);
        }
        let Some(joints) = placed.into_iter().collect::<Option<Vec<_>>>() else {
            unreachable!("every axis has a direction");
        };
        let Ok(joints) = joints.try_into() else {
            unreachable!("the number of joints is unchanged");
        };
        Ok(Self {
            joints,
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

    /// A planar arm whose gravity [m/s^2] acts against y.
    pub(super) fn planar(joints: &[ChainJoint; N], gravity: f64) -> Self {
        Self::new(joints, [0.0, -gravity, 0.0]).expect("every axis has a direction")
    }
}

/// Joint positions.
type Posture<R, const N: usize> = [JointPosture<R>; N];

/// Torques per inertial parameter, link by link.
pub struct Regressor<R, const N: usize>([[[R; N]; LINK_PARAMETER_COUNT]; N]);

impl<R, const N: usize> AsRef<[[R; N]]> for Regressor<R, N> {
    #[inline(always)]
    fn as_ref(&self) -> &[[R; N]] {
        self.0.as_flattened()
    }
}

impl<const N: usize> Arm<N> for SerialChain<N> {
    type Base<R: Real> = [[R; LINK_PARAMETER_COUNT]; N];
    type Posture<R: Real> = Posture<R, N>;
    type Regressor<R: Real> = Regressor<R, N>;

    const DEPENDS_ON_ANGLE: [bool; N] = [true; N];
    const PLANAR: bool = false;
    const PARAMETERS: &'static [Parameter] = &LINK_PARAMETERS;
    const HAS_OUTLINED_EQUATIONS: bool = true;

    fn names(&self) -> Vec<Name> {
        let of = |i: usize| LINK_PARAMETERS.map(|parameter| (parameter.name, Some(i + 1)));
        (0..N).flat_map(of).collect()
    }

    /// The pseudo-inertia matrix of a body (Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018) is
    /// positive definite. If those of all links are, the inertia matrix is too.
    fn check(&self, values: &[f64], _: &[Option<f64>; N]) -> Result<(), (usize, &'static str)> {
        for (i, body) in values
            .as_chunks::<LINK_PARAMETER_COUNT>()
            .0
            .iter()
            .enumerate()
        {
            let first = i * LINK_PARAMETER_COUNT;
            if body[0] <= 0.0 {
                return Err((first, "positive"));
            }
            if !is_body(body) {
                let must = "that of a body: the link's pseudo-inertia matrix positive definite";
                return Err((first + 4, must));
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn base<R: Real>(&self, values: &[R]) -> [[R; LINK_PARAMETER_COUNT]; N] {
        std::array::from_fn(|i| std::array::from_fn(|k| values[i * LINK_PARAMETER_COUNT + k]))
    }

    #[inline(always)]
    fn map_base<R: Real, L: Real>(
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        to: impl Fn(R) -> L,
    ) -> [[L; LINK_PARAMETER_COUNT]; N] {
        let mut all = [[to(base[0][0]); LINK_PARAMETER_COUNT]; N];
        for i in 0..N {
            for k in 0..LINK_PARAMETER_COUNT {
                all[i][k] = to(base[i][k]);
            }
        }
        all
    }

    #[inline(always)]
    fn posture<R: Real>(&self, q: &[R; N]) -> Posture<R, N> {
        let mut all = [self.joints[0].posture(q[0]); N];
        for i in 1..N {
            all[i] = self.joints[i].posture(q[i]);
        }
        all
    }

    #[inline(always)]
    fn near<R: Real>(&self, from: &Posture<R, N>, increment: &[R; N]) -> Posture<R, N> {
        let mut all = *from;
        for i in 0..N {
            self.joints[i].advance(&mut all[i], increment[i]);
        }
        all
    }

    #[inline(always)]
    fn map_posture<R: Real, L: Real>(at: &Posture<R, N>, to: impl Fn(R) -> L) -> Posture<L, N> {
        let mut all = [at[0].map(&to); N];
        for i in 1..N {
            all[i] = at[i].map(&to);
        }
        all
    }

    fn chain(&self) -> Self {
        *self
    }

    #[inline(always)]
    fn transmission(&self) -> Option<&Transmission<N>> {
        self.transmission.as_ref()
    }

    #[inline(always)]
    fn inertia<R: Real>(
        &self,
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        at: &Posture<R, N>,
    ) -> [[R; N]; N] {
        run_out_of_line::<R, _>(MassMatrix(self, base, at))
    }

    #[inline(always)]
    fn bias<R: Real>(
        &self,
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        at: &Posture<R, N>,
        dq: &[R; N],
    ) -> [R; N] {
        self.torques(base, at, dq, &[R::splat(0.0); N])
    }

    #[inline(always)]
    fn torques<R: Real>(
        &self,
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        at: &Posture<R, N>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N] {
        run_out_of_line::<R, _>(NewtonEuler(self, base, at, dq, ddq))
    }

    #[inline(always)]
    fn regressor<R: Real>(&self, at: &Posture<R, N>, dq: &[R; N], ddq: &[R; N]) -> Regressor<R, N> {
        run_out_of_line::<R, _>(PerParameter(self, at, dq, ddq))
    }

    fn potential<R: Real>(&self, base: &[[R; LINK_PARAMETER_COUNT]; N], at: &Posture<R, N>) -> R {
        // mass and first moment of all links from the i-th, about its origin
        let (mut mass, mut moment) = (R::splat(0.0), [R::splat(0.0); 3]);
        for i in (0..N).rev() {
            let [link_mass, x, y, z, ..] = base[i];
            mass = mass + link_mass;
            let rotated = times(&at[i].rotation, &plus(&moment, &[x, y, z]));
            moment = scaled(mass, &self.joints[i].origin(&at[i]), &rotated);
        }
        -dot(&splat(&self.gravity), &moment)
    }

    #[inline(always)]
    fn accelerometers<R: Real>(&self, at: &Posture<R, N>, dq: &[R; N], ddq: &[R; N]) -> [R; N] {
        let mut reading = [R::splat(0.0); N];
        for (i, motion) in run_out_of_line::<R, _>(Motions(self, at, dq, ddq))
            .iter()
            .enumerate()
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
    fn absolute_rates<R: Real>(&self, at: &Posture<R, N>, dq: &[R; N]) -> [R; N] {
        let mut rates = *dq;
        for (i, motion) in run_out_of_line::<R, _>(Motions(self, at, dq, dq))
            .iter()
            .enumerate()
        {
            rates[i] = dot(&splat(&self.joints[i].axis), &motion.rate);
        }
        rates
    }

    #[inline(always)]
    fn link_signals<R: Real>(
        &self,
        at: &Posture<R, N>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [[R; N]; LINK_SIGNALS] {
        let mut all = [[R::splat(0.0); N]; LINK_SIGNALS];
        for (i, motion) in run_out_of_line::<R, _>(Motions(self, at, dq, ddq))
            .iter()
            .enumerate()
        {
            let signals = of_link([motion.force, motion.turning, motion.rate]);
            for k in 0..LINK_SIGNALS {
                all[k][i] = signals[k];
            }
        }
        all
    }
}

/// Whether ten parameters belong to a body: [[S, h], [h', m]] has a Cholesky factor, where S =
/// tr(I)/2 - I is the second moment of mass.
fn is_body(&[mass, x, y, z, xx, xy, yy, xz, yz, zz]: &[f64; LINK_PARAMETER_COUNT]) -> bool {
    let half = 0.5 * (xx + yy + zz);
    let mut l = [
        [half - xx, -xy, -xz, x],
        [-xy, half - yy, -yz, y],
        [-xz, -yz, half - zz, z],
        [x, y, z, mass],
    ];
    for j in 0..4 {
        for k in 0..j {
            for i in j..4 {
                l[i][j] -= l[i][k] * l[j][k];
            }
        }
        if l[j][j].is_nan() || l[j][j] <= 0.0 {
            return false;
        }
        let root = l[j][j].sqrt();
        for i in j..4 {
            l[i][j] /= root;
        }
    }
    true
}

/// Recursions compiled as separate functions, because every stage of every step calls them:
/// inlined, those of six links would be most of the program.
macro_rules! out_of_line {
    ($($(#[$doc:meta])* $name:ident($($at:tt: $argument:ty),*) -> $output:ty = $work:expr;)*) => {$(
        $(#[$doc])*
        struct $name<'a, R: Real, const N: usize>(&'a SerialChain<N>, $(&'a $argument),*);

        impl<R: Real, const N: usize> Work for $name<'_, R, N> {
            type Output = $output;
            #[inline(always)]
            fn run(self) -> $output {
                $work(self.0, $(self.$at),*)
            }
        }
    )*};
}

out_of_line! {
    /// [`SerialChain::mass_matrix`].
    MassMatrix(1: [[R; LINK_PARAMETER_COUNT]; N], 2: Posture<R, N>) -> [[R; N]; N] = SerialChain::mass_matrix;
    /// [`SerialChain::newton_euler`].
    NewtonEuler(1: [[R; LINK_PARAMETER_COUNT]; N], 2: Posture<R, N>, 3: [R; N], 4: [R; N]) -> [R; N]
        = SerialChain::newton_euler;
    /// [`SerialChain::torques_per_parameter`].
    PerParameter(1: Posture<R, N>, 2: [R; N], 3: [R; N]) -> Regressor<R, N>
        = |chain: &SerialChain<N>, at, dq, ddq| Regressor(chain.torques_per_parameter(at, dq, ddq));
    /// [`SerialChain::motions`].
    Motions(1: Posture<R, N>, 2: [R; N], 3: [R; N]) -> [recursion::LinkMotion<R>; N]
        = SerialChain::motions;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::TwoLink;
    use crate::plant::rigid::base_regressor;
    use proptest::prelude::*;

    /// A chain without parallel axes; every third joint is prismatic.
    fn chain<const N: usize>() -> SerialChain<N> {
        let joint = |i: usize| {
            let k = i as f64;
            ChainJoint {
                joint_type: match i % 3 {
                    1 => JointType::Prismatic,
                    _ => JointType::Revolute,
                },
                position: [0.3, 0.05 * k, -0.1],
                attitude: [0.4 - 0.2 * k, 0.5 * k - 0.7, 0.3],
                axis: [0.3 * k, -0.4, 1.0],
                accelerometer_distance: 0.3,
            }
        };
        SerialChain::new(&std::array::from_fn(joint), [0.5, -0.3, -9.8]).expect("axes")
    }

    /// Different links of about 4 kg and 0.3 m.
    fn bodies<const N: usize>() -> Vec<f64> {
        let body = |k: usize| {
            let x = 0.01 * k as f64;
            [
                4.0 + x,
                0.3,
                -0.1,
                0.1 + x,
                0.3,
                0.01,
                0.35 + x,
                -0.02,
                0.01,
                0.4,
            ]
        };
        (0..N).flat_map(body).collect()
    }

    /// Identities between the recursions; torques are of the order of 100 N m.
    fn check<const N: usize>([q, dq, ddq]: &[[f64; N]; 3]) {
        let (arm, values) = (chain::<N>(), bodies::<N>());
        assert_eq!(arm.check(&values, &[None; N]), Ok(()));
        let (base, at) = (arm.base(&values), arm.posture(q));
        let near = |one: f64, other: f64| {
            assert!(
                (one - other).abs() < 1e-11 * (100.0 + one.abs()),
                "{one} {other}"
            );
        };
        let torques = arm.torques(&base, &at, dq, ddq);
        let (inertia, bias) = (arm.inertia(&base, &at), arm.bias(&base, &at, dq));
        let (regressor, units) = (
            arm.regressor(&at, dq, ddq),
            base_regressor(&arm, q, dq, ddq),
        );
        for i in 0..N {
            let accelerated: f64 = (0..N).map(|j| inertia[i][j] * ddq[j]).sum();
            near(torques[i], accelerated + bias[i]);
            for (column, unit) in regressor.as_ref().iter().zip(&units) {
                near(column[i], unit[i]);
            }
            let columns = units.iter().zip(&values);
            near(
                torques[i],
                columns.map(|(column, value)| column[i] * value).sum(),
            );
        }
        // a nearby position, and the work of gravity, which depends on the position only
        let increment = std::array::from_fn(|i| 1e-5 * (1.0 + dq[i]));
        let ends = [1.0, -1.0].map(|side| arm.near(&at, &increment.map(|x| side * x)));
        let gained = arm.potential(&base, &ends[0]) - arm.potential(&base, &ends[1]);
        let gravity = arm.bias(&base, &at, &[0.0; N]);
        let work: f64 = (0..N).map(|i| 2.0 * increment[i] * gravity[i]).sum();
        // the cube of steps of about 1e-4 rad in all, times energies of the order of 100 J
        assert!((gained - work).abs() < 1e-9, "{gained} {work}");
    }

    proptest! {
        #[test]
        fn recursions_agree(motion in prop::array::uniform3(prop::array::uniform6(-2.0..2.0f64))) {
            check(&motion.map(|row| [row[0]]));
            check(&motion.map(|row| [row[0], row[1]]));
            check(&motion.map(|row| [row[0], row[1], row[2]]));
            check(&motion);
        }

        #[test]
        fn planar_two_link_chain_agrees_with_closed_form(motion in prop::array::uniform3(prop::array::uniform2(-2.0..2.0f64))) {
            let (l, g, distance) = (0.35, 9.81, [0.33, 0.27]);
            let joint = |index: usize| ChainJoint {
                joint_type: JointType::Revolute,
                position: [l * index as f64, 0.0, 0.0],
                attitude: [0.0; 3],
                axis: [0.0, 0.0, 1.0],
                accelerometer_distance: distance[index],
            };
            let chain = SerialChain::new(&[joint(0), joint(1)], [0.0, -g, 0.0]).expect("axes");
            let planar = TwoLink::<true> { link_length: l, gravity: g, accelerometer_distance: distance };
            let [[m, h, i], [m_2, h_2, i_2]] = [[6.0, 0.9, 0.5], [3.0, 0.4, 0.3]];
            let body = |m, h, i: f64| [m, h, 0.0, 0.0, 0.6 * i, 0.0, i, 0.0, 0.0, i];
            let bodies_of_chain = [body(m, h, i), body(m_2, h_2, i_2)];
            let of_planar = planar.base(&[i + m_2 * l * l, i_2, l * h_2, g * (h + m_2 * l), g * h_2]);
            let [q, dq, ddq] = &motion;
            let (at, at_planar) = (chain.posture(q), planar.posture(q));
            let pairs = [
                (chain.torques(&bodies_of_chain, &at, dq, ddq), planar.torques(&of_planar, &at_planar, dq, ddq)),
                (chain.accelerometers(&at, dq, ddq), planar.accelerometers(&at_planar, dq, ddq)),
                (chain.absolute_rates(&at, dq), planar.absolute_rates(&at_planar, dq)),
            ];
            let signals = [chain.link_signals(&at, dq, ddq), planar.link_signals(&at_planar, dq, ddq)];
            let all = [pairs.map(|pair| pair.0).to_vec(), signals[0].to_vec()].concat();
            let others = [pairs.map(|pair| pair.1).to_vec(), signals[1].to_vec()].concat();
            for (one, other) in all.as_flattened().iter().zip(others.as_flattened()) {
                prop_assert!((one - other).abs() < 1e-12 * 100.0, "{} {}", one, other);
            }
        }
    }

    #[test]
    fn impossible_inertias_are_rejected() {
        let (arm, values) = (chain::<2>(), bodies::<2>());
        let changed = |index: usize, value| {
            let mut values = values.clone();
            values[index] = value;
            arm.check(&values, &[None; 2]).map_err(|(index, _)| index)
        };
        assert_eq!(changed(10, 0.0), Err(10));
        assert_eq!(changed(11, 3.0), Err(14)); // center of mass farther out than the inertia about the origin allows
        assert_eq!(changed(4, 1.0), Err(4)); // larger than the sum of the other two
    }
}
