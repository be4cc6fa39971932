//! Derivatives by the sizes of effects that an arm does not have yet.
//!
//! Where an effect's sizes are nothing the arm moves as it would without, and the effect enters the
//! variational equations like any other parameter, by what a little of it would add to the gear's,
//! the motor's and the link's row. So an arm may be asked for the effects it lacks at hardly any
//! cost. What a little of an effect adds is its own derivative by a size, at size nothing, of numbers
//! with a derivative ([`Jet`]); the other parameters, such as velocities, have no influence then.

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

/// The effects that an arm lacks, joint by joint.
pub(crate) struct EffectSensitivity<L, const N: usize> {
    own: [Vec<OneSize<L>>; N],
    /// What z follows.
    hysteresis: [Option<Hysteresis<f64>>; N],
    /// z at the beginning of the step.
    pub(crate) z: [f64; N],
    /// What the links' parts follow that swing by themselves.
    flexible: [Option<FlexibleLink<f64>>; N],
    /// Their angles and velocities in space at the beginning of the step.
    part: [Swing; N],
    /// What the springs follow that bases turn on.
    soft: [Option<SoftBase<f64>>; N],
    /// Their torques, and the rates of these, at the beginning of the step.
    base: [Swing; N],
}

/// What obeys an equation of the second order by itself, and its rate.
type Swing = [f64; 2];

/// One size of an effect, which is nothing but moves.
pub(crate) struct OneSize<L> {
    /// Its place among the parameters of its joint's effects.
    pub(crate) place: usize,
    size: Size,
    /// The effects with this size alone, for stages side by side and for one instant.
    effects: Effects<Jet<L>>,
    at_once: Effects<Jet<f64>>,
}

/// A joint at one instant, for its effects.
struct Moment<R> {
    motor_angle: R,
    motor_velocity: R,
    link_angle: R,
    angle_in_space: R,
    twist: R,
    z: R,
    /// Torque of the gear at the motor [N m].
    load: R,
    stiffness: R,
    damping: R,
    /// Of the link's part that swings by itself.
    part_acceleration: R,
    /// Of the spring that the base turns on.
    base: BaseTorque<R>,
}

/// What a little of an effect adds, per size.
pub(crate) struct Adds<R> {
    /// To what dry friction can take up.
    pub(crate) friction: R,
    /// To the motor's torque.
    pub(crate) motor: R,
    /// To the torque through the gear.
    pub(crate) gear: R,
    /// To the motor's lever.
    pub(crate) lever: R,
    /// To what the link bears, or the link and those before it.
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
    /// What it adds where an event ends a stretch.
    pub(crate) fn at_an_event<S: Real>(
        &self,
        held: &Holding<S>,
        z: f64,
        base: BaseTorque<f64>,
    ) -> Adds<f64> {
        let moment = Moment {
            motor_angle: held.motor_angle,
            motor_velocity: held.speed,
            link_angle: 0.0, // what the link bears does not hold the motor
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

/// The effects of one joint whose values are given, of which one moves.
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
    /// Of a configuration and its parameters, in a motion that begins in a state.
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
            for (place, (_, size)) in kinds.parameters().into_iter().enumerate() {
                let Some(size) = size else { continue };
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

    /// The spring that one joint's base turns on, at the beginning of the step.
    #[inline(always)]
    pub(crate) fn base(&self, joint: usize) -> BaseTorque<f64> {
        let [torque, rate] = self.base[joint];
        BaseTorque { torque, rate }
    }

    /// The sizes of one joint's effects.
    pub(crate) fn of(&self, joint: usize) -> &[OneSize<L>] {
        &self.own[joint]
    }

    /// What the effects would add at the stages of a step of length `h`; `push` is what one newton
    /// metre less at each motor makes of its acceleration.
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

    /// Accelerations of the part of one link that swings by itself, at the stages of a step of length
    /// `h`.
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

    /// The torque in the spring that one joint's base turns on, at the stages of a step of length
    /// `h`.
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

    /// The step is made: what gears remember, parts of links swing by and bases turn on, where it
    /// ended.
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

/// What obeys an equation of the second order by itself, at the stages of a step.
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

    /// The integrator's own step of length `h`.
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

/// Where it is at the end of a step of length `h`, from its accelerations at the stages.
#[inline(always)]
fn moved_on([place, rate]: Swing, &[a1, a2, a3, a4]: &Stages, h: f64) -> Swing {
    [
        place + h * rate + h * h / 6.0 * (a1 + a2 + a3),
        rate + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4),
    ]
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
    let mut values = Vec::with_capacity(parameters.len());
    for (&(role, i), &value) in config.roles().iter().zip(parameters) {
        let Role::Effect(place) = role else {
            values.push(value);
            continue;
        };
        let is_size = config.joints[i].effects.parameters()[place].1.is_some();
        if is_size && value != 0.0 {
            return None;
        }
    }
    Some((plain, values))
}
