//! The arm with rigid gears, (5)-(7): torques of a motion.

use crate::arm::Arm;
use crate::arm::transmission::{motor_of, outputs_of};
use crate::joint::gear::AllLaws;
use crate::plant::Plant;

/// Motor torques [N m] of a motion of the links with rigid gears, (5).
///
/// The Coulomb torque of a resting joint is set to zero; any value within +-f_M is possible.
pub fn inverse_dynamics<A: Arm<N>, const N: usize>(
    plant: &Plant<A, f64, AllLaws, N, true>,
    q: &[f64; N],
    dq: &[f64; N],
    ddq: &[f64; N],
) -> [f64; N] {
    let at = plant.arm.posture(q);
    let mut load = plant.arm.torques(&plant.base, &at, dq, ddq);
    for (i, joint) in plant.joints.iter().enumerate().take(plant.arm.joints()) {
        load[i] += joint.link_viscous * dq[i];
    }
    let [outputs, rates, accelerations] = [q, dq, ddq].map(|all| outputs_of(&plant.arm, all));
    let effect_loads: [f64; N] = std::array::from_fn(|i| plant.joints[i].effects.load(q[i]));
    std::array::from_fn(|j| {
        let (joint, n) = (&plant.joints[j], plant.joints[j].ratio);
        let (angle, velocity) = (outputs[j] / n, rates[j] / n);
        let direction = if velocity == 0.0 {
            0.0
        } else {
            velocity.signum()
        };
        let friction = joint.motor_viscous * rates[j] / n
            + plant.dry_friction(velocity, 0.0, j) * direction
            + joint.offset;
        let at_motor = |torques| motor_of(&plant.arm, j, n, torques, 0.0);
        at_motor(&load)
            + joint.motor_inertia * accelerations[j] / n
            + friction
            + (at_motor(&effect_loads) - joint.effects.motor_torque(angle, velocity))
    })
}
