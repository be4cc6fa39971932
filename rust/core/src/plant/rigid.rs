//! The arm with rigid gears, (5)-(7): torques of a motion, linear in the base parameters.

use crate::arm::Arm;
use crate::joint::gear::AllLaws;
use crate::plant::Plant;

/// Link-side torques [N m] per base parameter, in the order of [`Arm::names`].
///
/// The equations are linear in the base parameters, so each column is their value with that
/// parameter at one and the others at zero.
pub fn base_regressor<A: Arm<N>, const N: usize>(
    arm: &A,
    q: &[f64; N],
    dq: &[f64; N],
    ddq: &[f64; N],
) -> Vec<[f64; N]> {
    let at = arm.posture(q);
    let mut unit = vec![0.0; arm.names().len()];
    (0..unit.len())
        .map(|k| {
            unit.fill(0.0);
            unit[k] = 1.0;
            arm.torques(&arm.base(&unit), &at, dq, ddq)
        })
        .collect()
}

/// Motor torques [N m] of a motion of the links with rigid gears, (5).
///
/// The Coulomb torque of a resting joint is set to zero; any value within +-f_M is possible.
pub fn inverse_dynamics<A: Arm<N>, const N: usize>(
    plant: &Plant<A, f64, AllLaws, N, true>,
    q: &[f64; N],
    dq: &[f64; N],
    ddq: &[f64; N],
) -> [f64; N] {
    let mut torque = plant
        .arm
        .torques(&plant.base, &plant.arm.posture(q), dq, ddq);
    for (i, joint) in plant.joints.iter().enumerate() {
        let n = joint.ratio;
        let direction = if dq[i] == 0.0 { 0.0 } else { dq[i].signum() };
        let friction = joint.motor_viscous * dq[i] / n
            + plant.dry_friction(dq[i] / n, 0.0, i) * direction
            + joint.offset;
        torque[i] = n * (torque[i] + joint.link_viscous * dq[i])
            + joint.motor_inertia * ddq[i] / n
            + friction;
        torque[i] += n * joint.effects.load(q[i]) - joint.effects.motor_torque(q[i] / n, dq[i] / n);
    }
    torque
}
