//! Derivatives with respect to sizes of effects that are zero.
//!
//! With sizes of zero the arm moves as without the effects, and a size enters the variational
//! equations like any other parameter, through its derivatives of the gear's, the motor's and the
//! link's row at zero. They are computed over [`Jet`]s. Other parameters of the effects, such as
//! velocities, have no influence then. Score tests therefore cost little more than the
//! derivatives of the fit.

use crate::arm::Arm;
use crate::arm::transmission::{coupled, motor_of, outputs_of, share};
use crate::experiment::Source;
use crate::joint::effects::{
    AffectedTerms, BaseTorque, Effect, EffectKinds, Effects, FlexibleLink, Hysteresis,
    PartDeflection, Size, SoftBase,
};
use crate::joint::gear::{Gears, Spring};
use crate::plant::config::{Config, Role};
use crate::plant::{Modes, Plant, State, angle_in_space};
use crate::scalar::{Jet, Real};
use crate::sensitivity::forcing::{
    GEAR_EFFECTS, LINK_EFFECTS, MOTOR_EFFECTS, Quads, coupled_slot, moves_coupled,
};
use crate::sensitivity::holding::Holding;
use crate::sensitivity::trace::{Stage, Stages, Trace};

/// Effects of size zero, joint by joint.
pub(crate) struct EffectSensitivity<L, const N: usize> {
    sizes: [Vec<OneSize<L>>; N],
    /// Hysteresis laws.
    hysteresis: [Option<Hysteresis<f64>>; N],
    /// z at the beginning of the step.
    pub(crate) z: [f64; N],
    /// Laws of the flexible parts.
    flexible: [Option<FlexibleLink<f64>>; N],
    /// Angles and velocities of the flexible parts in space at the beginning of the step.
    part: [SecondOrderState; N],
    /// Laws of the bases.
    soft: [Option<SoftBase<f64>>; N],
    /// Torques of the bases' springs and their rates at the beginning of the step.
    base: [SecondOrderState; N],
}

/// State of a second-order equation, and its rate.
type SecondOrderState = [f64; 2];

/// Derivatives with respect to one size at zero.
pub(crate) struct OneSize<L> {
    /// Index among the parameters of the joint's effects.
    pub(crate) position: usize,
    pub(crate) size: Size,
    /// The effects with the derivative of this size, for stages in lanes and for one instant.
    effects: Effects<Jet<L>>,
    scalar_effects: Effects<Jet<f64>>,
}

/// State of a joint at one instant, for its effects.
struct JointInstant<R> {
    motor_angle: R,
    motor_velocity: R,
    link_angle: R,
    angle_in_space: R,
    torsion: R,
    z: R,
    /// Torque of the gears at the motor [N m].
    load: R,
    stiffness: R,
    damping: R,
    /// Acceleration of the flexible part.
    part_acceleration: R,
    /// State of the spring under the base.
    base: BaseTorque<R>,
}

/// Derivatives of the equations with respect to a size.
pub(crate) struct SizeDerivatives<R> {
    /// Derivative of the friction limit.
    pub(crate) friction: R,
    /// Derivative of the motor torque.
    pub(crate) motor: R,
    /// Derivative of the gear torque.
    pub(crate) gear: R,
    /// Derivatives of the error of the gear's output and of the local ratio.
    pub(crate) error: R,
    pub(crate) local_ratio: R,
    /// Derivative of the load torque on the link, or on the link and all preceding links.
    pub(crate) link: R,
}

impl<R: Real> SizeDerivatives<R> {
    #[inline(always)]
    fn of(effects: &Effects<Jet<R>>, affects: AffectedTerms, at: &JointInstant<R>) -> Self {
        let zero = R::splat(0.0);
        let mut derivatives = Self {
            friction: zero,
            motor: zero,
            gear: zero,
            error: zero,
            local_ratio: zero,
            link: zero,
        };
        let (angle, velocity) = (
            Jet::constant(at.motor_angle),
            Jet::constant(at.motor_velocity),
        );
        if affects.friction {
            let load = Jet::constant(at.load);
            derivatives.friction = effects.dry_friction(velocity, load).tangent;
        }
        if affects.motor {
            derivatives.motor = effects.motor_torque(angle, velocity).tangent;
        }
        if affects.gear {
            let [error, slope] = effects.error(angle).map(|one| one.tangent);
            let strain = effects.strain(Jet::constant(at.torsion)).tangent;
            let rotation = |torque: R| effects.base_rotation(Jet::constant(torque)).tangent;
            let [base_angle, base_rate] = [rotation(at.base.torque), rotation(at.base.rate)];
            let damped = at.damping * slope.mul_add(at.motor_velocity, base_rate);
            let hysteresis = effects.gear_torque(Jet::constant(at.z)).tangent;
            let strained = error + strain + base_angle;
            derivatives.gear = at.stiffness.mul_add(strained, damped + hysteresis);
            (derivatives.error, derivatives.local_ratio) = (error, slope);
        }
        if affects.link {
            derivatives.link = effects.load(Jet::constant(at.link_angle)).tangent;
        }
        if affects.weight {
            let weight = effects.weight(Jet::constant(at.angle_in_space));
            let load = effects.part_load(Jet::constant(at.part_acceleration));
            derivatives.link = (weight + load).tangent;
        }
        derivatives
    }
}

impl<L: Real> OneSize<L> {
    /// Derivatives at the event at the end of a span, for a size of one of the joints that load the
    /// motor of the event.
    pub(crate) fn at_event<S: Real, const N: usize>(
        &self,
        holding: &Holding<S, N>,
        joint: usize,
        (z, base): (f64, BaseTorque<f64>),
        [motor_angle, motor_velocity]: [f64; 2],
    ) -> SizeDerivatives<f64> {
        let instant = JointInstant {
            motor_angle,
            motor_velocity,
            link_angle: 0.0, // the load on the link does not hold the motor
            angle_in_space: 0.0,
            torsion: holding.torsion[joint].angle.lane(0),
            z,
            load: holding.ratio * holding.transmitted,
            stiffness: holding.stiffness[joint],
            damping: holding.damping[joint],
            part_acceleration: 0.0,
            base,
        };
        SizeDerivatives::of(&self.scalar_effects, self.size.affects, &instant)
    }
}

/// Effects of one joint with given values, one of which has derivative one.
fn seed_effects<R: Real>(kinds: EffectKinds, values: &[f64], position: usize) -> Effects<Jet<R>> {
    let mut next = 0;
    Effects::of(kinds, || {
        let mut value = Jet::constant(R::splat(values[next]));
        if next == position {
            value.tangent = R::splat(1.0);
        }
        next += 1;
        value
    })
}

impl<L: Real, const N: usize> EffectSensitivity<L, N> {
    /// From a configuration with its parameters, and the initial state, for the sizes among the
    /// directions.
    pub(crate) fn new<A: Arm<N>, S: Real>(
        config: &Config<A, N>,
        parameters: &[f64],
        directions: &[Source],
        begin: &State<S, N>,
    ) -> Self {
        let roles = config.roles();
        let of_joint = |i: usize| -> Vec<usize> {
            let is_of_joint = |k: &usize| matches!(roles[*k], (Role::Effect(_), j) if j == i);
            (0..roles.len()).filter(is_of_joint).collect()
        };
        let mut sizes = std::array::from_fn(|_| Vec::new());
        let (mut hysteresis, mut flexible, mut soft) = ([None; N], [None; N], [None; N]);
        for i in 0..config.arm.joints() {
            let (kinds, places) = (config.joints[i].effects, of_joint(i));
            let values: Vec<f64> = places.iter().map(|&k| parameters[k]).collect();
            for (position, parameter) in kinds.parameters().into_iter().enumerate() {
                let Some(size) = parameter.size else { continue };
                if !directions.contains(&Source::Parameter(places[position])) {
                    continue;
                }
                sizes[i].push(OneSize {
                    position,
                    size,
                    effects: seed_effects(kinds, &values, position),
                    scalar_effects: seed_effects(kinds, &values, position),
                });
            }
            if sizes[i].is_empty() {
                continue;
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
            sizes,
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
        &self.sizes[joint]
    }

    /// Adds the derivatives at the stages of a step of length `h` to `quads`; `push` is the change
    /// of each motor's acceleration per negative motor torque.
    #[inline(always)]
    pub(crate) fn add_to_quads<A: Arm<N>, S: Real, G: Gears>(
        &self,
        quads: &mut Quads<N>,
        plant: &Plant<A, L, G, N>,
        (trace, h): (&Trace<A, N>, f64),
        modes: &Modes<S, N>,
        push: &[f64; N],
    ) {
        for i in 0..plant.arm.joints() {
            let z = self.hysteresis_states(trace, h, i);
            let part_accelerations = self.part_accelerations(trace, h, i);
            let base_stages = self.base_stages(plant, trace, h, i);
            for first in (0..4).step_by(L::LANES) {
                let each = |number: fn(&Stage<N>) -> &[f64; N]| {
                    trace.across::<L>(first, |stage| number(stage)[i])
                };
                let (joint, torsion) = (&plant.joints[i], each(|stage| &stage.torsion));
                let (angle, spring) = (each(|stage| &stage.angle), &joint.spring);
                let [output, transmitted] = at_motor(plant, trace, first, i);
                let instant = JointInstant {
                    motor_angle: output * (1.0 / trace.ratio[i]),
                    motor_velocity: each(|stage| &stage.motor_velocity),
                    link_angle: angle,
                    angle_in_space: trace
                        .across::<L>(first, |stage| angle_in_space::<A, f64, N>(&stage.angle, i)),
                    torsion,
                    z: L::load(&z[first..]),
                    load: joint.ratio * transmitted,
                    stiffness: spring.stiffness(torsion),
                    damping: joint.gear_damping,
                    part_acceleration: L::load(&part_accelerations[first..]),
                    base: BaseTorque {
                        torque: L::load(&base_stages.value[first..]),
                        rate: L::load(&base_stages.rate[first..]),
                    },
                };
                let direction = L::splat(modes.direction[i].lane(0));
                for size in &self.sizes[i] {
                    let derivatives =
                        SizeDerivatives::of(&size.effects, size.size.affects, &instant);
                    let opposing = direction
                        .mul_add(derivatives.friction, derivatives.local_ratio * transmitted);
                    let motor = (opposing - derivatives.motor) * push[i];
                    let (quad, slot) = (size.size.index / 4, size.size.index % 4);
                    for lane in 0..L::LANES {
                        let stage = first + lane;
                        let of_joint = &mut quads[i];
                        of_joint[GEAR_EFFECTS + quad].0[stage][slot] = derivatives.gear.lane(lane);
                        of_joint[MOTOR_EFFECTS + quad].0[stage][slot] = motor.lane(lane);
                        of_joint[LINK_EFFECTS + quad].0[stage][slot] = derivatives.link.lane(lane);
                    }
                    if !moves_coupled(&plant.arm, i, size.size) {
                        continue;
                    }
                    let (quad, slot) = coupled_slot(i, size.size);
                    let rate = derivatives.local_ratio * instant.motor_velocity;
                    for k in 0..plant.arm.joints() {
                        let torsion = trace.across::<L>(first, |stage| stage.torsion[k]);
                        let moved = &plant.joints[k];
                        let stiffness = moved.spring.stiffness(torsion);
                        let torque =
                            stiffness.mul_add(derivatives.error, moved.gear_damping * rate);
                        let of_gear = torque * share(&plant.arm, k, i);
                        for lane in 0..L::LANES {
                            quads[k][quad].0[first + lane][slot] = of_gear.lane(lane);
                        }
                    }
                }
            }
        }
    }

    /// z of one gear at the stages of a step of length `h`.
    #[inline(always)]
    fn hysteresis_states<A: Arm<N>>(&self, trace: &Trace<A, N>, h: f64, i: usize) -> [f64; 4] {
        let Some(law) = &self.hysteresis[i] else {
            return [0.0; 4];
        };
        let from = trace.torsion_at(i, 0);
        let z = |k, t| law.state_after(self.z[i], &from, &trace.torsion_at(i, k), t);
        [self.z[i], z(1, 0.5 * h), z(2, 0.5 * h), z(3, h)]
    }

    /// Accelerations of the flexible part of one link at the stages of a step of length `h`.
    #[inline(always)]
    fn part_accelerations<A: Arm<N>>(&self, trace: &Trace<A, N>, h: f64, i: usize) -> Stages {
        let Some(law) = &self.flexible[i] else {
            return [0.0; 4];
        };
        let at = |k: usize, [angle, velocity]: SecondOrderState| {
            let stage = &trace.stages[k];
            law.part_acceleration(&PartDeflection {
                angle: angle - angle_in_space::<A, f64, N>(&stage.angle, i),
                rate: velocity - angle_in_space::<A, f64, N>(&stage.velocity, i),
            })
        };
        SecondOrderStages::integrate(self.part[i], h, at).acceleration
    }

    /// Torque of the spring under one joint's base at the stages of a step of length `h`.
    #[inline(always)]
    fn base_stages<A: Arm<N>, G: Gears>(
        &self,
        plant: &Plant<A, L, G, N>,
        trace: &Trace<A, N>,
        h: f64,
        i: usize,
    ) -> SecondOrderStages {
        let Some(law) = &self.soft[i] else {
            return SecondOrderStages::NONE;
        };
        let joint = &plant.joints[i];
        let mut gear = [0.0; 4];
        for first in (0..4).step_by(L::LANES) {
            let torsion = trace.across(first, |stage| stage.torsion[i]);
            let rate = trace.across(first, |stage| stage.rate[i]);
            let torque: L = joint
                .gear_damping
                .mul_add(rate, joint.spring.torque(torsion));
            torque.store(&mut gear[first..]);
        }
        SecondOrderStages::integrate(self.base[i], h, |k, [torque, rate]| {
            law.base_acceleration(&BaseTorque { torque, rate }, gear[k])
        })
    }

    /// Sets the states of the effects to the end of a step.
    #[inline(always)]
    pub(crate) fn advance_effect_states<A: Arm<N>, S: Real, G: Gears>(
        &mut self,
        plant: &Plant<A, L, G, N>,
        trace: &Trace<A, N>,
        end: &State<S, N>,
        h: f64,
    ) {
        for i in 0..plant.arm.joints() {
            if self.flexible[i].is_some() {
                self.part[i] =
                    advance_second_order(self.part[i], &self.part_accelerations(trace, h, i), h);
            }
            if self.soft[i].is_some() {
                let base_stages = self.base_stages(plant, trace, h, i);
                self.base[i] = advance_second_order(self.base[i], &base_stages.acceleration, h);
            }
            if let Some(law) = &self.hysteresis[i] {
                let to = trace.torsion_of(i, end);
                self.z[i] = law.state_after(self.z[i], &trace.torsion_at(i, 0), &to, h);
            }
        }
    }
}

/// Output angle of a motor's gear and the torque of the gears on it, before the gear's ratio, at
/// the stages from the `first`.
#[inline(always)]
fn at_motor<A: Arm<N>, L: Real, G: Gears, const N: usize>(
    plant: &Plant<A, L, G, N>,
    trace: &Trace<A, N>,
    first: usize,
    motor: usize,
) -> [L; 2] {
    let [mut angle, mut torque] = [[L::splat(0.0); N]; 2];
    for i in coupled(&plant.arm, motor) {
        let joint = &plant.joints[i];
        let torsion = trace.across::<L>(first, |stage| stage.torsion[i]);
        let rate = trace.across::<L>(first, |stage| stage.rate[i]);
        angle[i] = torsion + trace.across::<L>(first, |stage| stage.angle[i]);
        torque[i] = joint
            .gear_damping
            .mul_add(rate, joint.spring.torque(torsion));
    }
    if plant.arm.transmission().is_none() {
        return [angle[motor], torque[motor]];
    }
    let (one, zero) = (L::splat(1.0), L::splat(0.0));
    let output = outputs_of(&plant.arm, &angle)[motor];
    [output, motor_of(&plant.arm, motor, one, &torque, zero)]
}

/// A second-order equation at the stages of a step.
struct SecondOrderStages {
    value: Stages,
    rate: Stages,
    acceleration: Stages,
}

impl SecondOrderStages {
    const NONE: Self = Self {
        value: [0.0; 4],
        rate: [0.0; 4],
        acceleration: [0.0; 4],
    };

    /// The integrator's step of length `h`.
    #[inline(always)]
    fn integrate(
        [value, rate]: SecondOrderState,
        h: f64,
        at: impl Fn(usize, SecondOrderState) -> f64,
    ) -> Self {
        let half = 0.5 * h;
        let middle = value + half * rate;
        let a1 = at(0, [value, rate]);
        let second = [middle, rate + half * a1];
        let a2 = at(1, second);
        let third = [middle + half * half * a1, rate + half * a2];
        let a3 = at(2, third);
        let fourth = [value + h * rate + h * half * a2, rate + h * a3];
        let a4 = at(3, fourth);
        Self {
            value: [value, second[0], third[0], fourth[0]],
            rate: [rate, second[1], third[1], fourth[1]],
            acceleration: [a1, a2, a3, a4],
        }
    }
}

/// State at the end of a step of length `h`, from the accelerations at its stages.
#[inline(always)]
fn advance_second_order(
    [value, rate]: SecondOrderState,
    &[a1, a2, a3, a4]: &Stages,
    h: f64,
) -> SecondOrderState {
    [
        value + h * rate + h * h / 6.0 * (a1 + a2 + a3),
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
        let Role::Effect(position) = role else {
            values.push(value);
            continue;
        };
        let parameter = config.joints[i].effects.parameters()[position];
        if parameter.of_drive {
            values.push(value);
        } else if parameter.size.is_some() && value != 0.0 {
            return None;
        }
    }
    Some((plain, values))
}
