//! Where the joints of a chain are, and how they move.

use super::vector::{Matrix, Vector, cross, dot, times};

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointType {
    /// It turns about its axis.
    Revolute,
    /// It slides along its axis.
    Prismatic,
}

/// One joint of a chain as URDF places it: `<origin xyz=... rpy=...>` and `<axis xyz=...>`.
///
/// A row (a, alpha, d) of modified Denavit-Hartenberg parameters is the position
/// (a, -d sin alpha, d cos alpha), the attitude (alpha, 0, 0) and the axis (0, 0, 1).
#[derive(Clone, Copy, Debug)]
pub struct ChainJoint {
    /// How it moves.
    pub joint_type: JointType,
    /// The joint's origin [m] in the frame of the link before, or of the base.
    pub position: [f64; 3],
    /// Roll, pitch and yaw [rad] of the joint's frame at zero angle in that frame.
    pub attitude: [f64; 3],
    /// Its axis in its own frame, of any length but zero.
    pub axis: [f64; 3],
    /// l_a [m], how far from the axis the link's accelerometer sits; see
    /// [`super::SerialChain`].
    pub accelerometer_distance: f64,
}

/// A joint's constants, worked out once.
///
/// The link's frame is turned by cos(q) `cos` + sin(q) `sin` + `fixed` in that of the link before,
/// Rodrigues' formula behind the placement; a prismatic joint's by `fixed` alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) joint_type: JointType,
    pub(super) position: Vector<f64>,
    pub(super) axis: Vector<f64>,
    /// The axis in the frame of the link before.
    pub(super) slide: Vector<f64>,
    pub(super) cos: Matrix<f64>,
    pub(super) sin: Matrix<f64>,
    pub(super) fixed: Matrix<f64>,
    /// Across the axis, and across both.
    pub(super) x: Vector<f64>,
    pub(super) y: Vector<f64>,
    pub(super) accelerometer_distance: f64,
}

impl Placement {
    /// `None` where the axis has no direction.
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
        let still = joint.joint_type == JointType::Prismatic;
        let x = unit(&across(0)).filter(|_| axis[0].abs() < 0.999);
        let x = x.or_else(|| unit(&across(1)))?;
        Some(Self {
            joint_type: joint.joint_type,
            position: joint.position,
            axis,
            slide: times(&placed, &axis),
            cos: columns(&|j| if still { [0.0; 3] } else { across(j) }),
            sin: columns(&|j| {
                if still {
                    [0.0; 3]
                } else {
                    cross(&axis, &unit_vector(j))
                }
            }),
            fixed: columns(&|j| if still { unit_vector(j) } else { along(j) }),
            x,
            y: cross(&axis, &x),
            accelerometer_distance: joint.accelerometer_distance,
        })
    }
}

/// In the same direction, of length one.
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
