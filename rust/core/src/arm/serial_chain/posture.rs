//! Joint positions of a chain, a register of joints at a time.

use super::SerialChain;
use super::placement::{JointPosture, Placement};
use crate::arm::Arm;
use crate::arm::sine_cosine::SineCosine;
use crate::scalar::Real;

/// Room for the joints of any chain in whole registers; zeros beyond the joints.
pub(super) const ROOM: usize = 8;

/// One quantity of all joints.
pub(super) type Row<R> = [R; ROOM];

/// Several quantities of all joints.
pub(super) type Rows<R, const K: usize, const W: usize = ROOM> = [[R; W]; K];

#[inline(always)]
pub(super) fn zeros<R: Real, const K: usize, const W: usize>() -> Rows<R, K, W> {
    [[R::splat(0.0); W]; K]
}

/// Packs of the joints from the `first`.
#[inline(always)]
pub(super) fn load<R: Real, const K: usize, const W: usize>(
    rows: &Rows<R, K, W>,
    first: usize,
) -> [R::Pack; K] {
    let mut all = [R::splat(0.0).spread(); K];
    for k in 0..K {
        all[k] = R::pack(&rows[k][first..]);
    }
    all
}

/// [`load`] of constants.
#[inline(always)]
pub(super) fn load_constants<R: Real, const K: usize>(
    rows: &Rows<f64, K>,
    first: usize,
) -> [R::Pack; K] {
    let mut all = [R::splat(0.0).spread(); K];
    for k in 0..K {
        all[k] = R::pack_constants(&rows[k][first..]);
    }
    all
}

/// Stores packs of the joints from the `first`.
#[inline(always)]
pub(super) fn store<R: Real, const K: usize, const W: usize>(
    packs: &[R::Pack; K],
    rows: &mut Rows<R, K, W>,
    first: usize,
) {
    for k in 0..K {
        R::unpack(packs[k], &mut rows[k][first..]);
    }
}

/// Constants of all joints, [`Placement`]. The origin of the first link's frame is the point of
/// reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placements {
    pub(super) cos: [Rows<f64, 3>; 3],
    pub(super) sin: [Rows<f64, 3>; 3],
    pub(super) fixed: [Rows<f64, 3>; 3],
    pub(super) position: Rows<f64, 3>,
    /// Zero for revolute joints.
    pub(super) slide: Rows<f64, 3>,
    pub(super) axis: Rows<f64, 3>,
    /// 1 for revolute joints, 0 for prismatic ones; and the reverse.
    pub(super) types: Rows<f64, 2>,
}

impl Placements {
    pub(super) fn new(joints: &[Placement]) -> Self {
        let vectors = [[0.0; ROOM]; 3];
        let mut all = Self {
            cos: [vectors; 3],
            sin: [vectors; 3],
            fixed: [vectors; 3],
            position: vectors,
            slide: vectors,
            axis: vectors,
            types: [[0.0; ROOM]; 2],
        };
        for (i, joint) in joints.iter().enumerate() {
            let is_prismatic = !joint.is_revolute();
            for a in 0..3 {
                for b in 0..3 {
                    all.cos[a][b][i] = joint.cos[a][b];
                    all.sin[a][b][i] = joint.sin[a][b];
                    all.fixed[a][b][i] = joint.fixed[a][b];
                }
                if i > 0 {
                    all.position[a][i] = joint.position[a];
                    all.slide[a][i] = f64::from(u8::from(is_prismatic)) * joint.slide[a];
                }
                all.axis[a][i] = joint.axis[a];
            }
            all.types[usize::from(is_prismatic)][i] = 1.0;
        }
        all
    }
}

/// Joint positions.
#[derive(Clone, Copy)]
pub struct Posture<R> {
    /// Sines and cosines of revolute joints.
    turn: Rows<R, 2>,
    /// Displacements [m] of prismatic joints.
    pub(super) shift: Row<R>,
}

impl<R: Real> Posture<R> {
    #[inline(always)]
    pub(super) fn map<L: Real>(&self, to: impl Fn(R) -> L) -> Posture<L> {
        let mut all = Posture {
            turn: zeros::<L, 2, ROOM>(),
            shift: [L::splat(0.0); ROOM],
        };
        for i in 0..ROOM {
            all.turn[0][i] = to(self.turn[0][i]);
            all.turn[1][i] = to(self.turn[1][i]);
            all.shift[i] = to(self.shift[i]);
        }
        all
    }

    /// Sines and cosines of a pack of joints.
    #[inline(always)]
    pub(super) fn turn(&self, first: usize) -> SineCosine<R::Pack> {
        let [sin, cos] = load(&self.turn, first);
        SineCosine { sin, cos }
    }
}

impl<const N: usize, const KNOWN: bool> SerialChain<N, KNOWN> {
    #[inline(always)]
    pub(super) fn posture_at<R: Real>(&self, q: &[R; N]) -> Posture<R> {
        let shift = padded(q);
        let mut turn = zeros::<R, 2, ROOM>();
        for first in (0..self.joints()).step_by(R::PACKED) {
            let is_revolute = R::pack_constants(&self.placements.types[0][first..]);
            let at = SineCosine::of(R::pack(&shift[first..]) * is_revolute);
            store(&[at.sin, at.cos], &mut turn, first);
        }
        Posture { turn, shift }
    }

    /// Moves a posture by small angles and displacements.
    #[inline(always)]
    pub(super) fn posture_near<R: Real>(
        &self,
        from: &Posture<R>,
        increment: &[R; N],
    ) -> Posture<R> {
        let (increment, mut all) = (padded(increment), *from);
        for first in (0..self.joints()).step_by(R::PACKED) {
            let by = R::pack(&increment[first..]);
            let is_revolute = R::pack_constants(&self.placements.types[0][first..]);
            let at = from.turn(first).plus_small_angle(by * is_revolute);
            store(&[at.sin, at.cos], &mut all.turn, first);
            R::unpack(R::pack(&from.shift[first..]) + by, &mut all.shift[first..]);
        }
        all
    }

    /// Position of a link's frame in that of the preceding link.
    #[inline(always)]
    pub(super) fn joint_at<R: Real>(&self, at: &Posture<R>, i: usize) -> JointPosture<R> {
        let [sin, cos] = [at.turn[0][i], at.turn[1][i]];
        self.joints[i].at(SineCosine { sin, cos }, at.shift[i])
    }
}

/// Numbers of the joints with zeros beyond.
#[inline(always)]
pub(super) fn padded<R: Real, const N: usize>(numbers: &[R; N]) -> Row<R> {
    let mut row = [R::splat(0.0); ROOM];
    row[..N].copy_from_slice(numbers);
    row
}
