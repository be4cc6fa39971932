//! Initial motion of an experiment.

use crate::actuation::current_loop::CurrentLoop;
use crate::arm::Arm;
use crate::arm::transmission::link_of;
use crate::experiment::{Initial, Source};
use crate::joint::gear::Gears;
use crate::plant::friction::Motion;
use crate::plant::{Plant, State};
use crate::scalar::Real;

/// Initial motion of an experiment.
pub(crate) fn start<A: Arm<N>, S: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    plant: &Plant<A, S, G, N, EFFECTS>,
    current: &CurrentLoop<S, N>,
    initial: &Initial<N>,
    lift: &impl Fn(Source, f64) -> S,
) -> Motion<S, N> {
    let each = |source: fn(usize) -> Source, values: &[f64; N]| -> [S; N] {
        std::array::from_fn(|i| lift(source(i), values[i]))
    };
    let mut state = State {
        motor_angle: each(Source::MotorAngle, &initial.motor_angle),
        motor_velocity: each(Source::MotorVelocity, &initial.motor_velocity),
        link_angle: each(Source::LinkAngle, &initial.link_angle.unwrap_or([0.0; N])),
        link_velocity: each(Source::LinkVelocity, &initial.link_velocity),
        ..State::zero()
    };
    if initial.link_angle.is_none() {
        let equilibrium = solve_equilibrium(plant, &state.motor_angle);
        for i in 0..plant.arm.joints() {
            state.link_angle[i] = equilibrium[i] + state.link_angle[i];
        }
    }
    for i in 0..plant.arm.joints() {
        if plant.is_rigid(i) {
            let (ratios, zero) = (plant.ratios(), S::splat(0.0));
            let of_motors = |motors| link_of(&plant.arm, i, &ratios, motors, zero);
            state.link_angle[i] = of_motors(&state.motor_angle);
            state.link_velocity[i] = of_motors(&state.motor_velocity);
        }
    }
    plant.carry_parts(&mut state);
    plant.load_bases(&mut state);
    let torque = std::array::from_fn(|i| {
        let voltage = plant.joints[i].effective_voltage(S::splat(initial.voltage[i]));
        voltage * current.torque_per_volt[i]
    });
    let modes = plant.modes_at(&state, &torque);
    for i in 0..plant.arm.joints() {
        // friction holds the motor for every small change, so its velocity has no derivative
        if modes.free[i].lane(0) == 0.0 {
            state.motor_velocity[i] = S::splat(0.0);
        }
    }
    Motion {
        state,
        torque,
        modes,
    }
}

/// Link angles [rad] in equilibrium with gravity, for fixed motor angles.
///
/// Fixed-point iteration: gravity at the previous angles determines the torsion of gears and the
/// rotation of bases. The stiffness of gravity is about a thousandth of theirs, so each iteration
/// gains three digits. After convergence the number of iterations is doubled, because derivatives
/// converge as fast but start later.
fn solve_equilibrium<A: Arm<N>, S: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    plant: &Plant<A, S, G, N, EFFECTS>,
    motor_angle: &[S; N],
) -> [S; N] {
    let unloaded_link_angle: [S; N] =
        std::array::from_fn(|i| plant.driven_angle(motor_angle, i, S::splat(0.0)).0);
    let mut angle = unloaded_link_angle;
    let mut converged_at = None;
    for round in 0..400 {
        let at = plant.arm.posture(&angle);
        let mut gravity = plant.arm.bias(&plant.base, &at, &[S::splat(0.0); N]);
        if EFFECTS {
            let loads = plant.static_loads(&angle);
            gravity = std::array::from_fn(|i| gravity[i] + loads[i]);
        }
        let mut change = 0.0f64;
        for i in 0..plant.arm.joints() {
            if !plant.is_rigid(i) {
                let joint = &plant.joints[i];
                let mut next = unloaded_link_angle[i] - joint.torsion::<EFFECTS>(gravity[i]);
                if EFFECTS {
                    next = next - joint.effects.base_rotation(gravity[i]);
                }
                change = change.max((next - angle[i]).lane(0).abs());
                angle[i] = next;
            }
        }
        if change < 1e-15 && converged_at.is_none() {
            converged_at = Some(round);
        }
        if converged_at.is_some_and(|at| round > 2 * at) {
            break;
        }
    }
    angle
}
