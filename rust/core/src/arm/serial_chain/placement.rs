//! Positions and motions of the joints of a chain.

use super::vector::{Matrix, Vector, cross, dot, scaled, splat, times};
use crate::arm::sine_cosine::SineCosine;
use crate::scalar::Real;

/// Kind of motion of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointType {
    /// Rotation about the axis.
    Revolute,
    /// Translation along the axis.
    Prismatic,
}

/// One joint of a chain as URDF places it: `<origin xyz=... rpy=...>` and `<axis xyz=...>`.
///
/// A row (a, alpha, d) of modified Denavit-Hartenberg parameters is the position
/// (a, -d sin alpha, d cos alpha), the attitude (alpha, 0, 0) and the axis (0, 0, 1).
#[derive(Clone, Copy, Debug)]
pub struct ChainJoint {
    /// Kind of motion.
    pub joint_type: JointType,
    /// The joint's origin [m] in the frame of the preceding link, or of the base.
    pub position: [f64; 3],
    /// Roll, pitch and yaw [rad] of the joint's frame at zero angle in that frame.
    pub attitude: [f64; 3],
    /// Axis in the joint's frame; its length does not matter.
    pub axis: [f64; 3],
    /// l_a [m], distance of the link's accelerometer from the axis; see [`super::SerialChain`].
    pub accelerometer_distance: f64,
}

impl ChainJoint {
    /// A joint of a planar arm at this distance along the preceding link: it rotates in the plane,
    /// or moves along x.
    pub(crate) fn planar(joint_type: JointType, distance: f64) -> Self {
        Self {
            joint_type,
            position: [distance, 0.0, 0.0],
            attitude: [0.0; 3],
            axis: match joint_type {
                JointType::Revolute => [0.0, 0.0, 1.0],
                JointType::Prismatic => [1.0, 0.0, 0.0],
            },
            accelerometer_distance: 1.0,
        }
    }
}

/// Constants of a joint.
///
/// The rotation of the link's frame relative to the preceding link is cos(q) `cos` + sin(q) `sin` +
/// `fixed`, Rodrigues' formula after the placement; that of a prismatic joint is `fixed`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) joint_type: JointType,
    pub(super) position: Vector<f64>,
    pub(super) axis: Vector<f64>,
    /// The axis in the frame of the preceding link.
    pub(super) slide: Vector<f64>,
    pub(super) cos: Matrix<f64>,
    pub(super) sin: Matrix<f64>,
    pub(super) fixed: Matrix<f64>,
    /// Perpendicular to the axis, and to both.
    pub(super) x: Vector<f64>,
    pub(super) y: Vector<f64>,
    pub(super) accelerometer_distance: f64,
}

impl Placement {
    /// `None` if the axis has length zero.
    pub(super) fn new(joint: &ChainJoint) -> Option<Self> {
        let axis = unit(&joint.axis)?;
        let placed = attitude(&joint.attitude);
        let columns = |column: &dyn Fn(usize) -> Vector<f64>| -> Matrix<f64> {
            let all = [column(0), column(1), column(2)].map(|column| times(&placed, &column));
            std::array::from_fn(|i| std::array::from_fn(|j| all[j][i]))
        };
        let along = |j: usize| axis.map(|a| a * axis[j]);
        let unit_vector = |j: usize| std::array::from_fn(|i| f64::from(u8::from(i == j)));
        let across = |j: usize| {
            let (one, along): ([f64; 3], _) = (unit_vector(j), along(j));
            std::array::from_fn(|i| one[i] - along[i])
        };
        let is_prismatic = joint.joint_type == JointType::Prismatic;
        let x = unit(&across(0)).filter(|_| axis[0].abs() < 0.999);
        let x = x.or_else(|| unit(&across(1)))?;
        Some(Self {
            joint_type: joint.joint_type,
            position: joint.position,
            axis,
            slide: times(&placed, &axis),
            cos: columns(&|j| if is_prismatic { [0.0; 3] } else { across(j) }),
            sin: columns(&|j| {
                if is_prismatic {
                    [0.0; 3]
                } else {
                    cross(&axis, &unit_vector(j))
                }
            }),
            fixed: columns(&|j| {
                if is_prismatic {
                    unit_vector(j)
                } else {
                    along(j)
                }
            }),
            x,
            y: cross(&axis, &x),
            accelerometer_distance: joint.accelerometer_distance,
        })
    }
}

impl Placement {
    #[inline(always)]
    pub(super) fn is_revolute(&self) -> bool {
        self.joint_type == JointType::Revolute
    }

    /// Position of the link's frame for a sine and cosine of the angle, and a displacement.
    #[inline(always)]
    pub(super) fn at<R: Real>(&self, turn: SineCosine<R>, shift: R) -> JointPosture<R> {
        let mut rotation = [[shift; 3]; 3];
        for k in 0..3 {
            let fixed = scaled(turn.sin, &splat(&self.sin[k]), &splat(&self.fixed[k]));
            rotation[k] = scaled(turn.cos, &splat(&self.cos[k]), &fixed);
        }
        let position = splat(&self.position);
        let origin = if self.is_revolute() {
            position
        } else {
            scaled(shift, &splat(&self.slide), &position)
        };
        JointPosture { rotation, origin }
    }
}

/// Position of a link's frame in that of the preceding link.
#[derive(Clone, Copy)]
pub(super) struct JointPosture<R> {
    pub(super) rotation: Matrix<R>,
    pub(super) origin: Vector<R>,
}

/// The unit vector in this direction.
fn unit(a: &Vector<f64>) -> Option<Vector<f64>> {
    let length = dot(a, a).sqrt();
    (length > 0.0 && length.is_finite()).then(|| a.map(|entry| entry / length))
}

/// Rz(yaw) Ry(pitch) Rx(roll).
fn attitude(&[roll, pitch, yaw]: &[f64; 3]) -> Matrix<f64> {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}
