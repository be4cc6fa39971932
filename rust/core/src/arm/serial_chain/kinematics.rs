//! Motion of the links of a chain of any number of joints.

use super::SerialChain;
use super::placement::Placement;
use super::recursion::LinkMotion;
use crate::arm::sine_cosine::SineCosine;
use crate::scalar::{Jet, Real};

/// Joints of a chain, and gravity.
#[derive(Clone, Debug)]
pub struct Kinematics {
    joints: Vec<Placement>,
    /// [m/s^2] in the base frame.
    gravity: [f64; 3],
}

impl<const N: usize, const KNOWN: bool> From<SerialChain<N, KNOWN>> for Kinematics {
    fn from(chain: SerialChain<N, KNOWN>) -> Self {
        Self {
            joints: chain.joints[..chain.count].to_vec(),
            gravity: chain.gravity,
        }
    }
}

impl Kinematics {
    /// Entries of the motion of a link: angular velocity [rad/s], angular acceleration [rad/s^2]
    /// and specific force [m/s^2] of its origin, in its frame.
    pub const ENTRIES: usize = 9;

    /// Motion of the links: samples times links times entries. A row of joints per sample.
    pub fn link_motion(&self, angle: &[f64], velocity: &[f64], acceleration: &[f64]) -> Vec<f64> {
        let n = self.joints.len();
        let mut all = Vec::with_capacity(angle.len() * Self::ENTRIES);
        for row in 0..angle.len() / n {
            let mut motion = LinkMotion::of_base(&self.gravity);
            for (joint, k) in self.joints.iter().zip(row * n..) {
                motion = motion.next(joint, [angle[k], velocity[k], acceleration[k]]);
                all.extend(motion.entries());
            }
        }
        all
    }

    /// Derivatives of [`Self::link_motion`] with respect to angles, velocities and accelerations,
    /// each samples times links times entries times joints.
    pub fn link_motion_derivatives(
        &self,
        angle: &[f64],
        velocity: &[f64],
        acceleration: &[f64],
    ) -> [Vec<f64>; 3] {
        let n = self.joints.len();
        let mut all = [0; 3].map(|_| vec![0.0; angle.len() * Self::ENTRIES * n]);
        for k in (0..angle.len()).step_by(n) {
            let row = [angle, velocity, acceleration].map(|list| &list[k..k + n]);
            for (kind, derivatives) in all.iter_mut().enumerate() {
                let places = k * Self::ENTRIES * n..(k + n) * Self::ENTRIES * n;
                self.differentiate(row, kind, &mut derivatives[places]);
            }
        }
        all
    }

    /// Derivatives with respect to angles (`kind` 0), velocities (1) or accelerations (2).
    fn differentiate(&self, motion: [&[f64]; 3], kind: usize, derivatives: &mut [f64]) {
        let n = self.joints.len();
        // links before a joint do not depend on its motion
        let mut before = LinkMotion::of_base(&self.gravity);
        for j in 0..n {
            let mut link = before;
            for i in j..n {
                let mut own = motion.map(|list| Jet::constant(list[i]));
                if i == j {
                    before = before.next(&self.joints[i], own);
                    own[kind].tangent = 1.0;
                }
                link = link.next(&self.joints[i], own);
                for (entry, value) in link.entries().iter().enumerate() {
                    derivatives[(i * Self::ENTRIES + entry) * n + j] = value.tangent;
                }
            }
        }
    }
}

impl<R: Real> LinkMotion<R> {
    fn next(&self, joint: &Placement, [q, dq, ddq]: [R; 3]) -> Self {
        self.of_next(joint, &joint.at(SineCosine::of(q), q), dq, ddq)
    }

    fn entries(&self) -> [R; Kinematics::ENTRIES] {
        let all = [self.rate, self.turning, self.force];
        std::array::from_fn(|k| all[k / 3][k % 3])
    }
}
