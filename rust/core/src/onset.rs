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
use crate::config::Config;
use crate::effects::{EffectKinds, Hysteresis, Twist};
use crate::margin::Holding;
use crate::plant::{Joint, State};
use crate::real::Real;
use crate::variation::{Places, Stages, Trace};

/// Which entries of the variational equations belong to which effect of one joint.
#[derive(Clone, Copy, Default)]
struct Entries {
    stribeck: Option<usize>,
    hysteresis: Option<usize>,
    /// Of a and b, each in the gear's row and in the motor's.
    kinematic_error: Option<[[usize; 2]; 2]>,
}

/// The effects that an arm lacks, joint by joint.
pub(crate) struct Onset<const N: usize> {
    entries: [Entries; N],
    /// w_s [rad/s].
    velocity: [f64; N],
    /// What z follows.
    hysteresis: [Option<Hysteresis<f64>>; N],
    /// z at the beginning of the step.
    pub(crate) z: [f64; N],
}

/// One joint's motor and gear at the four stages of a step.
pub(crate) struct Drive<L> {
    pub(crate) motor_angle: L,
    pub(crate) motor_velocity: L,
    /// Sign that friction opposes.
    pub(crate) direction: L,
    /// What one newton metre less at the motor makes of n ddtheta_M.
    pub(crate) push: L,
    pub(crate) stiffness: L,
    /// Torque [N m] through the gear.
    pub(crate) transmitted: L,
}

impl<const N: usize> Onset<N> {
    /// Of a configuration and its parameters; `places` says where each parameter's entries are.
    pub(crate) fn new<A: Arm<N>>(
        config: &Config<A, N>,
        parameters: &[f64],
        places: &Places,
    ) -> Self {
        let names = config.parameter_names();
        let at = |name: &str, i: usize| names.iter().position(|&n| n == (name, Some(i + 1)));
        let value = |name, i| at(name, i).map(|k| parameters[k]);
        let entries = |name, i| at(name, i).map(|k| &places[k]);
        Self {
            entries: std::array::from_fn(|i| Entries {
                stribeck: entries("stribeck_friction", i).map(|own| own[0].entry),
                hysteresis: entries("hysteresis_torque", i).map(|own| own[0].entry),
                kinematic_error: entries("kinematic_error_cos", i)
                    .zip(entries("kinematic_error_sin", i))
                    .map(|(cos, sin)| [cos, sin].map(|own| [own[0].entry, own[1].entry])),
            }),
            velocity: std::array::from_fn(|i| value("stribeck_velocity", i).unwrap_or(1.0)),
            hysteresis: std::array::from_fn(|i| {
                let twist = value("hysteresis_twist", i)?;
                Some(Hysteresis { torque: 0.0, twist })
            }),
            z: [0.0; N],
        }
    }

    /// What joint `i`'s effects would add at the stages from the `first`.
    #[inline(always)]
    pub(crate) fn enter<L: Real>(
        &self,
        entries: &mut [Stages],
        (i, first): (usize, usize),
        joint: &Joint<L>,
        drive: &Drive<L>,
    ) {
        let own = &self.entries[i];
        let mut put = |entry: usize, value: L| value.store(&mut entries[entry][first..]);
        if let Some(entry) = own.stribeck {
            let share = drive.motor_velocity * L::splat(1.0 / self.velocity[i]);
            let left = (-(share * share)).exp();
            put(entry, drive.push * drive.direction * left);
        }
        if let Some(of) = own.kinematic_error {
            for (k, [error, slope]) in unit_errors(drive.motor_angle).into_iter().enumerate() {
                let rate = slope * drive.motor_velocity;
                put(
                    of[k][0],
                    drive.stiffness.mul_add(error, joint.gear_damping * rate),
                );
                put(of[k][1], drive.push * slope * drive.transmitted);
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

    /// z at the four stages of a step of length `h`.
    #[inline(always)]
    pub(crate) fn twist(&self, entries: &mut [Stages], trace: &Trace<N>, h: f64) {
        for i in 0..N {
            if let (Some(entry), Some(law)) = (self.entries[i].hysteresis, &self.hysteresis[i]) {
                let from = trace.twist_at(i, 0);
                let z = |k, t| law.after(self.z[i], &from, &trace.twist_at(i, k), t);
                entries[entry] = [self.z[i], z(1, 0.5 * h), z(2, 0.5 * h), z(3, h)];
            }
        }
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

impl<const N: usize> Trace<N> {
    /// Of gear `i` at stage `k`.
    #[inline(always)]
    fn twist_at(&self, i: usize, k: usize) -> Twist<f64> {
        let stage = &self.stages[k];
        Twist {
            angle: stage.twist[i],
            rate: self.ratio[i].mul_add(stage.motor_velocity[i], -stage.velocity[i]),
        }
    }

    /// Of gear `i` in a state.
    #[inline(always)]
    fn twist_of<S: Real>(&self, i: usize, x: &State<S, N>) -> Twist<f64> {
        let n = S::splat(self.ratio[i]);
        Twist {
            angle: n.mul_add(x.motor_angle[i], -x.link_angle[i]).lane(0),
            rate: n.mul_add(x.motor_velocity[i], -x.link_velocity[i]).lane(0),
        }
    }
}
