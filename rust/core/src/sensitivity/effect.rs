//! Derivatives by the sizes of effects that an arm does not have yet.
//!
//! Where an effect's size is nothing the arm moves as it would without, and the effect enters the
//! variational equations like any other parameter, by what a little of it would add to the gear's
//! and the motor's row. So an arm may be asked for the effects it lacks at hardly any cost:
//!
//! - Stribeck's friction adds -exp(-(dtheta_M/w_s)^2) where Coulomb's adds -1;
//! - hysteresis adds its z, which follows the twist, to the gear's torque;
//! - a kinematic error e adds K e + d_G de/dt to it, and -e' times the whole to the motor's.
//!
//! The lengths w_s and delta_h have no influence then.

use crate::arm::Arm;
use crate::joint::effects::{EffectKinds, Hysteresis};
use crate::joint::gear::{Gears, Spring};
use crate::plant::config::Config;
use crate::plant::{Modes, Plant, State};
use crate::scalar::Real;
use crate::sensitivity::forcing::{GEAR_EFFECTS, KINEMATIC, MOTOR_EFFECTS, Quads};
use crate::sensitivity::holding::Holding;
use crate::sensitivity::trace::{Stage, Trace};

/// The effects that an arm lacks, joint by joint.
pub(crate) struct EffectSensitivity<const N: usize> {
    effects: [EffectKinds; N],
    /// w_s [rad/s].
    velocity: [f64; N],
    /// What z follows.
    hysteresis: [Option<Hysteresis<f64>>; N],
    /// z at the beginning of the step.
    pub(crate) z: [f64; N],
}

impl<const N: usize> EffectSensitivity<N> {
    /// Of a configuration and its parameters.
    pub(crate) fn new<A: Arm<N>>(config: &Config<A, N>, parameters: &[f64]) -> Self {
        let names = config.parameter_names();
        let value = |name, i| {
            let at = names.iter().position(|&n| n == (name, Some(i + 1)))?;
            Some(parameters[at])
        };
        Self {
            effects: config.joints.map(|joint| joint.effects),
            velocity: std::array::from_fn(|i| value("stribeck_velocity", i).unwrap_or(1.0)),
            hysteresis: std::array::from_fn(|i| {
                let twist = value("hysteresis_twist", i)?;
                Some(Hysteresis { torque: 0.0, twist })
            }),
            z: [0.0; N],
        }
    }

    /// What the effects would add at the stages of a step of length `h`; `push` is what one newton
    /// metre less at each motor makes of its acceleration.
    #[inline(always)]
    pub(crate) fn enter<A: Arm<N>, S: Real, L: Real, G: Gears>(
        &self,
        quads: &mut Quads<N>,
        plant: &Plant<A, L, G, N>,
        (trace, h): (&Trace<N>, f64),
        modes: &Modes<S, N>,
        push: &[f64; N],
    ) {
        for i in 0..N {
            for first in (0..4).step_by(L::LANES) {
                let each = |number: fn(&Stage<N>) -> &[f64; N]| {
                    trace.across::<L>(first, |stage| number(stage)[i])
                };
                let (push, velocity) = (L::splat(push[i]), each(|stage| &stage.motor_velocity));
                let [gear, motor] = [GEAR_EFFECTS, MOTOR_EFFECTS];
                let mut put = |quad: usize, slot: usize, value: L| {
                    for lane in 0..L::LANES {
                        quads.own[i][quad].0[first + lane][slot] = value.lane(lane);
                    }
                };
                if self.effects[i].stribeck {
                    let direction = L::splat(modes.direction[i].lane(0));
                    let share = velocity * L::splat(1.0 / self.velocity[i]);
                    put(motor, 0, push * direction * (-(share * share)).exp());
                }
                if self.effects[i].kinematic_error {
                    let (joint, twist) = (&plant.joints[i], each(|stage| &stage.twist));
                    let (angle, rate) = (each(|stage| &stage.angle), each(|stage| &stage.rate));
                    let spring = &joint.spring;
                    let transmitted = joint.gear_damping.mul_add(rate, spring.torque(twist));
                    let motor_angle = (twist + angle) * L::splat(1.0 / trace.ratio[i]);
                    let errors = unit_errors(motor_angle).into_iter().enumerate();
                    for (k, [error, slope]) in errors {
                        let damped = joint.gear_damping * slope * velocity;
                        let sprung = spring.stiffness(twist).mul_add(error, damped);
                        put(gear, KINEMATIC + k, sprung);
                        put(motor, KINEMATIC + k, push * slope * transmitted);
                    }
                }
            }
            if let Some(law) = &self.hysteresis[i] {
                let from = trace.twist_at(i, 0);
                let z = |k, t| law.after(self.z[i], &from, &trace.twist_at(i, k), t);
                let z = [self.z[i], z(1, 0.5 * h), z(2, 0.5 * h), z(3, h)];
                for k in 0..4 {
                    quads.own[i][GEAR_EFFECTS].0[k][0] = z[k];
                }
            }
        }
    }

    /// What each of joint `i`'s effects adds where an event ends a stretch, in the order of
    /// [`EffectKinds::place`]: to dry friction, to the torque through the gear, and to the motor's
    /// lever.
    pub(crate) fn at_an_event<S: Real>(&self, i: usize, held: &Holding<S>) -> [[f64; 3]; 4] {
        let share = held.speed / self.velocity[i];
        let friction = [(-(share * share)).exp(), 0.0, 0.0];
        let [cos, sin] = unit_errors(held.motor_angle).map(|[error, slope]| {
            let rate = slope * held.speed;
            [0.0, held.stiffness * error + held.damping * rate, slope]
        });
        [friction, [0.0, self.z[i], 0.0], cos, sin]
    }

    /// The step is made: z where it ended.
    #[inline(always)]
    pub(crate) fn passed<S: Real>(&mut self, trace: &Trace<N>, end: &State<S, N>, h: f64) {
        for i in 0..N {
            if let Some(law) = &self.hysteresis[i] {
                let to = trace.twist_of(i, end);
                self.z[i] = law.after(self.z[i], &trace.twist_at(i, 0), &to, h);
            }
        }
    }
}

/// A kinematic error and its slope by the motor's angle, per a and per b.
#[inline(always)]
fn unit_errors<R: Real>(motor_angle: R) -> [[R; 2]; 2] {
    let two = R::splat(2.0);
    let (sin, cos) = (two * motor_angle).sin_cos();
    [[cos, -two * sin], [sin, two * cos]]
}

/// The configuration and the parameters without the effects, if none of these has any size.
pub(crate) fn without_effects<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    parameters: &[f64],
) -> Option<(Config<A, N>, Vec<f64>)> {
    let mut plain = *config;
    for joint in &mut plain.joints {
        joint.effects = EffectKinds::default();
    }
    let kept = plain.parameter_names();
    let mut values = Vec::with_capacity(kept.len());
    for (&name, &value) in config.parameter_names().iter().zip(parameters) {
        let length = matches!(name.0, "stribeck_velocity" | "hysteresis_twist");
        if kept.contains(&name) {
            values.push(value);
        } else if value != 0.0 && !length {
            return None;
        }
    }
    Some((plain, values))
}
