//! Derivatives with respect to sizes of effects that are zero.
//!
//! With sizes of zero the arm moves as without the effects, and a size enters the variational
//! equations like any other parameter, through its derivatives of the gear's, the motor's and the
//! link's row at zero. They are computed over [`Jet`]s. Other parameters of the effects, such as
//! velocities, have no influence then. Score tests therefore cost little more than the fit's own
//! derivatives.

use crate::arm::Arm;
use crate::joint::effects::{
    BaseTorque, Effect, EffectKinds, Effects, Enters, FlexibleLink, Hysteresis, Lead, Size,
    SoftBase,
};
use crate::joint::gear::{Gears, Spring};
use crate::plant::config::{Config, Role};
use crate::plant::{Modes, Plant, State, angle_in_space};
use crate::scalar::{Jet, Real};
use crate::sensitivity::forcing::{GEAR_EFFECTS, MOTOR_EFFECTS, Quads};
use crate::sensitivity::holding::Holding;
use crate::sensitivity::trace::{Stage, Stages, Trace};

/// Effects of size zero, joint by joint.
pub(crate) struct EffectSensitivity<L, const N: usize> {
    own: [Vec<OneSize<L>>; N],
    /// Hysteresis laws.
    hysteresis: [Option<Hysteresis<f64>>; N],
    /// z at the beginning of the step.
    pub(crate) z: [f64; N],
    /// Laws of the flexible parts.
    flexible: [Option<FlexibleLink<f64>>; N],
    /// Angles and velocities of the flexible parts in space at the beginning of the step.
    part: [Swing; N],
    /// Laws of the bases.
    soft: [Option<SoftBase<f64>>; N],
    /// Torques of the bases' springs and their rates at the beginning of the step.
    base: [Swing; N],
}

/// State of a second-order equation, and its rate.
type Swing = [f64; 2];

/// Derivatives with respect to one size at zero.
pub(crate) struct OneSize<L> {
    /// Index among the parameters of the joint's effects.
    pub(crate) place: usize,
    size: Size,
    /// The effects with the derivative of this size, for stages in lanes and for one instant.
    effects: Effects<Jet<L>>,
    at_once: Effects<Jet<f64>>,
}

/// State of a joint at one instant, for its effects.
struct Moment<R> {
    motor_angle: R,
    motor_velocity: R,
    link_angle: R,
    angle_in_space: R,
    twist: R,
    z: R,
    /// Gear torque at the motor [N m].
    load: R,
    stiffness: R,
    damping: R,
    /// Acceleration of the flexible part.
    part_acceleration: R,
    /// State of the spring under the base.
    base: BaseTorque<R>,
}

/// Derivatives of the equations with respect to a size.
pub(crate) struct Adds<R> {
    /// Derivative of the friction limit.
    pub(crate) friction: R,
    /// Derivative of the motor torque.
    pub(crate) motor: R,
    /// Derivative of the gear torque.
    pub(crate) gear: R,
    /// Derivative of the local ratio.
    pub(crate) lever: R,
    /// Derivative of the load torque on the link, or on the link and all preceding links.
    pub(crate) link: R,
}

impl<R: Real> Adds<R> {
    #[inline(always)]
    fn of(effects: &Effects<Jet<R>>, enters: Enters, at: &Moment<R>) -> Self {
        let zero = R::splat(0.0);
        let mut adds = Self {
            friction: zero,
            motor: zero,
            gear: zero,
            lever: zero,
            link: zero,
        };
        let (angle, velocity) = (
            Jet::constant(at.motor_angle),
            Jet::constant(at.motor_velocity),
        );
        if enters.friction {
            let load = Jet::constant(at.load);
            adds.friction = effects.dry_friction(velocity, load).tangent;
        }
        if enters.motor {
            adds.motor = effects.motor_torque(angle, velocity).tangent;
        }
        if enters.gear {
            let [off, slope] = effects.error(angle).map(|one| one.tangent);
            let strain = effects.strain(Jet::constant(at.twist)).tangent;
            let turn = |torque: R| effects.base_turn(Jet::constant(torque)).tangent;
            let [turned, turning] = [turn(at.base.torque), turn(at.base.rate)];
            let damped = at.damping * slope.mul_add(at.motor_velocity, turning);
            let remembered = effects.gear_torque(Jet::constant(at.z)).tangent;
            let strained = off + strain + turned;
            adds.gear = at.stiffness.mul_add(strained, damped + remembered);
            adds.lever = slope;
        }
        if enters.link {
            adds.link = effects.load(Jet::constant(at.link_angle)).tangent;
        }
        if enters.weight {
            let weight = effects.weight(Jet::constant(at.angle_in_space));
            let load = effects.part_load(Jet::constant(at.part_acceleration));
            adds.link = (weight + load).tangent;
        }
        adds
    }
}

impl<L: Real> OneSize<L> {
    /// Derivatives at the event at the end of a span.
    pub(crate) fn at_an_event<S: Real>(
        &self,
        held: &Holding<S>,
        z: f64,
        base: BaseTorque<f64>,
    ) -> Adds<f64> {
        let moment = Moment {
            motor_angle: held.motor_angle,
            motor_velocity: held.speed,
            link_angle: 0.0, // the load on the link does not hold the motor
            angle_in_space: 0.0,
            twist: held.twist.lane(0),
            z,
            load: held.ratio * held.transmitted,
            stiffness: held.stiffness,
            damping: held.damping,
            part_acceleration: 0.0,
            base,
        };
        Adds::of(&self.at_once, self.size.enters, &moment)
    }
}

/// Effects of one joint with given values, one of which has derivative one.
fn moving<R: Real>(kinds: EffectKinds, values: &[f64], place: usize) -> Effects<Jet<R>> {
    let mut next = 0;
    Effects::of(kinds, || {
        let mut value = Jet::constant(R::splat(values[next]));
        if next == place {
            value.tangent = R::splat(1.0);
        }
        next += 1;
        value
    })
}

impl<L: Real, const N: usize> EffectSensitivity<L, N> {
    /// From a configuration with its parameters, and the initial state.
    pub(crate) fn new<A: Arm<N>, S: Real>(
        config: &Config<A, N>,
        parameters: &[f64],
        begin: &State<S, N>,
    ) -> Self {
        let roles = config.roles();
        let values = |i: usize| -> Vec<f64> {
            let of_joint = |k: &usize| matches!(roles[*k], (Role::Effect(_), j) if j == i);
            let places = (0..roles.len()).filter(of_joint);
            places.map(|k| parameters[k]).collect()
        };
        let mut own = std::array::from_fn(|_| Vec::new());
        let (mut hysteresis, mut flexible, mut soft) = ([None; N], [None; N], [None; N]);
        for i in 0..N {
            let (kinds, values) = (config.joints[i].effects, values(i));
            for (place, parameter) in kinds.parameters().into_iter().enumerate() {
                let Some(size) = parameter.size else { continue };
                own[i].push(OneSize {
                    place,
                    size,
                    effects: moving(kinds, &values, place),
                    at_once: moving(kinds, &values, place),
                });
            }
            let mut all = values.iter();
            let effects: Effects<f64> = Effects::of(kinds, || *all.next().expect("a value"));
            hysteresis[i] = effects.hysteresis;
            flexible[i] = effects.flexible_link;
            soft[i] = effects.soft_base;
        }
        let part = |i: usize| [begin.part_angle[i], begin.part_velocity[i]].map(|one| one.lane(0));
        let base =
            |i: usize| [begin.base_torque[i], begin.base_torque_rate[i]].map(|one| one.lane(0));
        Self {
            own,
            hysteresis,
            z: [0.0; N],
            flexible,
            part: std::array::from_fn(part),
            soft,
            base: std::array::from_fn(base),
        }
    }

    /// State of the spring under one joint's base at the beginning of the step.
    #[inline(always)]
    pub(crate) fn base(&self, joint: usize) -> BaseTorque<f64> {
        let [torque, rate] = self.base[joint];
        BaseTorque { torque, rate }
    }

    /// Sizes of one joint.
    pub(crate) fn of(&self, joint: usize) -> &[OneSize<L>] {
        &self.own[joint]
    }

    /// Adds the derivatives at the stages of a step of length `h` to `quads`; `push` is the change
    /// of each motor's acceleration per negative motor torque.
    #[inline(always)]
    pub(crate) fn enter<A: Arm<N>, S: Real, G: Gears>(
        &self,
        quads: &mut Quads<N>,
        plant: &Plant<A, L, G, N>,
        (trace, h): (&Trace<N>, f64),
        modes: &Modes<S, N>,
        push: &[f64; N],
    ) {
        for i in 0..N {
            let z = self.remembered(trace, h, i);
            let swung = self.swung::<A>(trace, h, i);
            let swayed = self.swayed(plant, trace, h, i);
            for first in (0..4).step_by(L::LANES) {
                let each = |number: fn(&Stage<N>) -> &[f64; N]| {
                    trace.across::<L>(first, |stage| number(stage)[i])
                };
                let (joint, twist) = (&plant.joints[i], each(|stage| &stage.twist));
                let (angle, rate) = (each(|stage| &stage.angle), each(|stage| &stage.rate));
                let spring = &joint.spring;
                let transmitted = joint.gear_damping.mul_add(rate, spring.torque(twist));
                let moment = Moment {
                    motor_angle: (twist + angle) * L::splat(1.0 / trace.ratio[i]),
                    motor_velocity: each(|stage| &stage.motor_velocity),
                    link_angle: angle,
                    angle_in_space: trace
                        .across::<L>(first, |stage| angle_in_space::<A, f64, N>(&stage.angle, i)),
                    twist,
                    z: L::load(&z[first..]),
                    load: joint.ratio * transmitted,
                    stiffness: spring.stiffness(twist),
                    damping: joint.gear_damping,
                    part_acceleration: L::load(&swung[first..]),
                    base: BaseTorque {
                        torque: L::load(&swayed.place[first..]),
                        rate: L::load(&swayed.rate[first..]),
                    },
                };
                let direction = L::splat(modes.direction[i].lane(0));
                for own in &self.own[i] {
                    let adds = Adds::of(&own.effects, own.size.enters, &moment);
                    let against = direction.mul_add(adds.friction, adds.lever * transmitted);
                    let motor = L::splat(push[i]) * (against - adds.motor);
                    let (quad, slot) = (own.size.index / 4, own.size.index % 4);
                    for lane in 0..L::LANES {
                        let stage = first + lane;
                        quads.own[i][GEAR_EFFECTS + quad].0[stage][slot] = adds.gear.lane(lane);
                        quads.own[i][MOTOR_EFFECTS + quad].0[stage][slot] = motor.lane(lane);
                        quads.of_link(i, quad).0[stage][slot] = adds.link.lane(lane);
                    }
                }
            }
        }
    }

    /// z of one gear at the stages of a step of length `h`.
    #[inline(always)]
    fn remembered(&self, trace: &Trace<N>, h: f64, i: usize) -> [f64; 4] {
        let Some(law) = &self.hysteresis[i] else {
            return [0.0; 4];
        };
        let from = trace.twist_at(i, 0);
        let z = |k, t| law.follow(self.z[i], &from, &trace.twist_at(i, k), t);
        [self.z[i], z(1, 0.5 * h), z(2, 0.5 * h), z(3, h)]
    }

    /// Accelerations of the flexible part of one link at the stages of a step of length `h`.
    #[inline(always)]
    fn swung<A: Arm<N>>(&self, trace: &Trace<N>, h: f64, i: usize) -> Stages {
        let Some(law) = &self.flexible[i] else {
            return [0.0; 4];
        };
        let at = |k: usize, [angle, velocity]: Swing| {
            let stage = &trace.stages[k];
            law.part_acceleration(&Lead {
                angle: angle - angle_in_space::<A, f64, N>(&stage.angle, i),
                rate: velocity - angle_in_space::<A, f64, N>(&stage.velocity, i),
            })
        };
        Swaying::over(self.part[i], h, at).acceleration
    }

    /// Torque of the spring under one joint's base at the stages of a step of length `h`.
    #[inline(always)]
    fn swayed<A: Arm<N>, G: Gears>(
        &self,
        plant: &Plant<A, L, G, N>,
        trace: &Trace<N>,
        h: f64,
        i: usize,
    ) -> Swaying {
        let Some(law) = &self.soft[i] else {
            return Swaying::NONE;
        };
        let joint = &plant.joints[i];
        let mut gear = [0.0; 4];
        for first in (0..4).step_by(L::LANES) {
            let twist = trace.across(first, |stage| stage.twist[i]);
            let rate = trace.across(first, |stage| stage.rate[i]);
            let torque: L = joint.gear_damping.mul_add(rate, joint.spring.torque(twist));
            torque.store(&mut gear[first..]);
        }
        Swaying::over(self.base[i], h, |k, [torque, rate]| {
            law.base_acceleration(&BaseTorque { torque, rate }, gear[k])
        })
    }

    /// Sets the states of the effects to the end of a step.
    #[inline(always)]
    pub(crate) fn passed<A: Arm<N>, S: Real, G: Gears>(
        &mut self,
        plant: &Plant<A, L, G, N>,
        trace: &Trace<N>,
        end: &State<S, N>,
        h: f64,
    ) {
        for i in 0..N {
            if self.flexible[i].is_some() {
                self.part[i] = moved_on(self.part[i], &self.swung::<A>(trace, h, i), h);
            }
            if self.soft[i].is_some() {
                let swayed = self.swayed(plant, trace, h, i);
                self.base[i] = moved_on(self.base[i], &swayed.acceleration, h);
            }
            if let Some(law) = &self.hysteresis[i] {
                let to = trace.twist_of(i, end);
                self.z[i] = law.follow(self.z[i], &trace.twist_at(i, 0), &to, h);
            }
        }
    }
}

/// A second-order equation at the stages of a step.
struct Swaying {
    place: Stages,
    rate: Stages,
    acceleration: Stages,
}

impl Swaying {
    const NONE: Self = Self {
        place: [0.0; 4],
        rate: [0.0; 4],
        acceleration: [0.0; 4],
    };

    /// The integrator's step of length `h`.
    #[inline(always)]
    fn over([place, rate]: Swing, h: f64, at: impl Fn(usize, Swing) -> f64) -> Self {
        let half = 0.5 * h;
        let middle = place + half * rate;
        let a1 = at(0, [place, rate]);
        let second = [middle, rate + half * a1];
        let a2 = at(1, second);
        let third = [middle + half * half * a1, rate + half * a2];
        let a3 = at(2, third);
        let fourth = [place + h * rate + h * half * a2, rate + h * a3];
        let a4 = at(3, fourth);
        Self {
            place: [place, second[0], third[0], fourth[0]],
            rate: [rate, second[1], third[1], fourth[1]],
            acceleration: [a1, a2, a3, a4],
        }
    }
}

/// State at the end of a step of length `h`, from the accelerations at its stages.
#[inline(always)]
fn moved_on([place, rate]: Swing, &[a1, a2, a3, a4]: &Stages, h: f64) -> Swing {
    [
        place + h * rate + h * h / 6.0 * (a1 + a2 + a3),
        rate + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4),
    ]
}

/// The configuration and the parameters without effects on motor, gear and link, if the sizes of
/// all these effects are zero.
pub(crate) fn without_plant_effects<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    parameters: &[f64],
) -> Option<(Config<A, N>, Vec<f64>)> {
    let mut plain = *config;
    for joint in &mut plain.joints {
        joint.effects = joint.effects.of_drive();
    }
    let mut values = Vec::with_capacity(parameters.len());
    for (&(role, i), &value) in config.roles().iter().zip(parameters) {
        let Role::Effect(place) = role else {
            values.push(value);
            continue;
        };
        let parameter = config.joints[i].effects.parameters()[place];
        if parameter.of_drive {
            values.push(value);
        } else if parameter.size.is_some() && value != 0.0 {
            return None;
        }
    }
    Some((plain, values))
}
