//! One plain simulation with its sensitivities in blocks of directions.
//!
//! Smooth steps use [`crate::sensitivity::variational`]. So do the spans of a step between friction
//! events, with the derivatives of the events' times.

use std::marker::PhantomData;

use crate::actuation::current_loop::CurrentLoop;
use crate::arm::{Arm, Outlined};
use crate::experiment::simulate::Simulation;
use crate::experiment::{Diverged, Event, Member, Quantity, Source, Task, values};
use crate::joint::Joint;
use crate::joint::gear::Gears;
use crate::plant::friction::{Motion, Span};
use crate::plant::{Instant, Watch};
use crate::scalar::{Dual, Lanes, Work, works};
use crate::sensitivity::block_trajectory::{BlockTrajectory, LinearisedSpan};
use crate::sensitivity::event::EventSensitivity;
use crate::sensitivity::sample_buffer::SampleBuffer;
use crate::sensitivity::sensing::Sensing;
use crate::sensitivity::step_length::StepLengthSensitivity;
use crate::sensitivity::tangent::{Response, Tangent, Workspace};
use crate::sensitivity::tangent_block::TangentBlock;
use crate::sensitivity::trace::Trace;
use crate::sensitivity::variational::LinearisedStep;
use crate::sensitivity::{Sensitivities, Variant, decimated};
use crate::sensors::decimation::Decimation;

/// One arm with elastic gears, and derivatives in several directions: scalars `S`, `V::LANES`
/// directions per block, and lanes `L` for the stages of a step.
///
/// With `EFFECTS`, directions may be sizes of effects on motor, gear and link that the arm does not
/// have: `requested` is the arm with these effects at size zero, with the parameters and directions
/// of each variant. Otherwise `requested` is the arm itself.
pub(crate) struct ForwardSensitivity<'a, A, S, V, L, G, const N: usize, const EFFECTS: bool> {
    pub(crate) task: &'a Task<A, N>,
    pub(crate) member: &'a Member<'a, N>,
    pub(crate) requested: &'a Task<A, N>,
    pub(crate) variants: &'a [Variant<'a>],
    /// With the parameters of each variant.
    pub(crate) members: &'a [Member<'a, N>],
    /// Low-pass of the samples, if there is one.
    pub(crate) decimation: Option<&'a Decimation>,
    pub(crate) scalars: PhantomData<(S, V, L, G)>,
}

impl<A: Arm<N>, S: Lanes, V: Lanes, L: Lanes, G: Gears, const N: usize, const EFFECTS: bool> Work
    for ForwardSensitivity<'_, A, S, V, L, G, N, EFFECTS>
{
    type Output = Result<Sensitivities<N>, Diverged>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut simulation = VariationalSimulation::<'_, A, S, V, L, G, N, EFFECTS>::new(&self);
        for (step, event) in self.task.clock.instants() {
            simulation.step(step, &event);
        }
        let VariationalSimulation {
            nominal, buffer, ..
        } = simulation;
        Ok(Sensitivities {
            values: decimated::<V, N>(values(&nominal.result()?), self.decimation),
            tangents: buffer.tangents,
        })
    }
}

struct VariationalSimulation<
    'a,
    A: Arm<N>,
    S: Lanes,
    V: Lanes,
    L: Lanes,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
> {
    task: &'a Task<A, N>,
    requested: &'a Task<A, N>,
    nominal: Simulation<'a, A, S, G, N>,
    /// Whether voltages were commanded at the last step.
    commanded: bool,
    /// Whether any drive has a lag other than zero.
    has_drive_lag: bool,
    /// Response without forcing by parameters.
    unforced: TangentBlock<S, N>,
    /// Current loops over a variable time.
    differentiable_current: CurrentLoop<Dual<S, S>, N>,
    trace: Trace<A, N>,
    linear: LinearisedStep<A, L, G, N>,
    blocks: Vec<BlockTrajectory<'a, A, S, V, G, N, EFFECTS>>,
    /// Of the first stage and of the later ones, for arms whose stages are separate functions.
    first_response: Response<V, N>,
    workspace: Workspace<V, N>,
    /// The sensors that are recorded, if any.
    sensing: Option<Sensing<V, N>>,
    buffer: SampleBuffer,
}

impl<'a, A: Arm<N>, S: Lanes, V: Lanes, L: Lanes, G: Gears, const N: usize, const EFFECTS: bool>
    VariationalSimulation<'a, A, S, V, L, G, N, EFFECTS>
{
    fn new(of: &ForwardSensitivity<'a, A, S, V, L, G, N, EFFECTS>) -> Self {
        let (task, requested) = (of.task, of.requested);
        let (samples, joints) = (task.clock.samples, task.config.arm.joints());
        let sizes = [task.record.len(), samples, joints];
        let (mut directions, mut ranges, mut variant_of) = (Vec::new(), Vec::new(), Vec::new());
        for (number, variant) in of.variants.iter().enumerate() {
            let first = directions.len();
            directions.extend_from_slice(variant.directions);
            ranges.push(first..directions.len());
            directions.resize(directions.len().next_multiple_of(V::LANES), Source::Nothing);
            variant_of.resize(directions.len() / V::LANES, number);
        }
        let width = directions.len();
        let plain = |_, value| S::splat(value);
        let nominal = Simulation::new(task, of.member, &plain);
        let sensing = Sensing::new(task, nominal.sensors.as_ref());
        let trajectory = |(block, &variant): (usize, &usize)| {
            let (member, first) = (&of.members[variant], block * V::LANES);
            let own = (&directions[..], first, variant);
            BlockTrajectory::new(requested, member, own, sensing.as_ref())
        };
        let has_lag = |joint: &Joint<S, G>| {
            let lag = joint.effects.drive_lag;
            lag.is_some_and(|lag| lag.time_constant.lane(0) != 0.0)
        };
        let linear = LinearisedStep::new(
            &task.config,
            of.member.parameters,
            (&requested.config, of.variants),
            (&directions, V::LANES),
            &nominal.motion.state,
            task.clock.step,
        );
        Self {
            task,
            requested,
            has_drive_lag: nominal.plant.joints.iter().any(has_lag),
            nominal,
            commanded: false,
            unforced: TangentBlock::new(&task.config, (&directions, width, 0), Tangent::zero()),
            differentiable_current: task.config.current_loop(task.clock.step),
            trace: Trace::new(task.config.arm, task.config.joints.map(|joint| joint.ratio)),
            linear,
            blocks: variant_of.iter().enumerate().map(trajectory).collect(),
            first_response: Response::zero(),
            workspace: Workspace::new(),
            sensing,
            buffer: SampleBuffer::new(sizes, (ranges, width), of.decimation),
        }
    }

    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event);
        } else if EFFECTS && (self.commanded || self.has_drive_lag) {
            // a lag of zero has settled one step after the command
            for trajectory in &mut self.blocks {
                trajectory.hold(&self.nominal.motion);
            }
            if self.has_drive_lag {
                self.nominal.hold();
            }
        }
        self.commanded = event.commands;
        let now = self.nominal.instant();
        self.nominal.sense(&now);
        if event.samples {
            self.nominal.record(step, &now);
        }
        let before = self.nominal.motion;
        if event.last {
            for k in 0..4 {
                self.trace.stage(k, &before.state, &now.acceleration);
            }
        } else {
            self.nominal.advance(&now, &mut self.trace);
        }
        let h = self.task.clock.step;
        self.linear
            .update::<V, S>(&self.trace, &now.posture, &before.modes, h);
        self.propagate(event, &before, &now);
        if self.nominal.spans.is_empty() {
            self.linear
                .advance_effect_states(&self.trace, &self.nominal.motion.state, h);
        }
    }

    fn command(&mut self, step: usize, event: &Event) {
        for trajectory in &mut self.blocks {
            if trajectory.has_torque_derivatives {
                trajectory.command(&self.nominal.motion, step, event.servo_reads);
            }
        }
        self.nominal.command(step, event.servo_reads);
    }

    /// Propagates the derivatives through an instant and the step that follows it.
    #[inline(always)]
    fn propagate(&mut self, event: &Event, before: &Motion<S, N>, now: &Instant<A, S, N>) {
        if let Some(sensing) = &mut self.sensing {
            sensing.compute_slopes(&self.nominal.plant.arm, &before.state, now);
        }
        let smooth = !event.last && self.nominal.spans.is_empty();
        let mut first = 0;
        for trajectory in &mut self.blocks {
            // memory of short arms is in registers
            let (mut local_response, mut local) = (Response::zero(), Workspace::new());
            let (response, workspace) = match A::OUTLINED {
                Outlined::Nothing => (&mut local_response, &mut local),
                _ => (&mut self.first_response, &mut self.workspace),
            };
            let torque = trajectory
                .has_torque_derivatives
                .then_some(&trajectory.torque);
            let TangentBlock {
                forcing, tangent, ..
            } = &mut trajectory.block;
            forcing.update(&self.linear.quads);
            forcing.respond::<_, _, _, true>(&self.linear, 0, tangent, torque, response);
            if let (Some(sensing), Some(block_sensors)) =
                (&self.sensing, &mut trajectory.block_sensors)
            {
                block_sensors.sense(&self.nominal.plant.arm, sensing, tangent, response);
            }
            if event.samples {
                let (quantities, buffer) = (&self.task.record, &mut self.buffer);
                V::scope(RecordWork(trajectory, quantities, buffer, first, response));
            }
            if smooth {
                trajectory.advance(&self.linear, response, workspace);
            }
            first += V::LANES;
        }
        if event.samples {
            self.buffer.store_sample::<V>();
        }
        if !event.last && !smooth {
            V::scope(RepeatWork(self));
        }
    }

    /// Repeats a step with friction events, span by span.
    #[inline(always)]
    fn repeat_step(&mut self) {
        for trajectory in &mut self.blocks {
            trajectory.remaining = V::splat(0.0);
        }
        for index in 0..self.nominal.spans.len() {
            let span = self.nominal.spans[index];
            let linearised_span = self.linearise_span(&span);
            for trajectory in &mut self.blocks {
                trajectory.advance_span(&self.linear, &linearised_span, &mut self.workspace);
            }
        }
        for trajectory in &mut self.blocks {
            if !trajectory.has_torque_derivatives {
                trajectory.torque = [V::splat(0.0); N];
            }
        }
    }

    /// Linearises a span for all blocks.
    #[inline(always)]
    fn linearise_span(&mut self, span: &Span<S, N>) -> LinearisedSpan<S, N> {
        let Span {
            from,
            length,
            event,
        } = span;
        let (nominal, trace) = (&self.nominal, &mut self.trace);
        let (plant, target) = (&nominal.plant, &nominal.target);
        let current = &nominal.current;
        let part = event.map_or(1.0, |event| event.0);
        let duration = part * length;
        let whole = (S::splat(*length), S::splat(part));
        let end = plant.retrace(from, target, current, whole, trace);
        let begin = plant.arm.posture(&from.state.link_angle);
        self.linear
            .update::<V, S>(trace, &begin, &from.modes, duration);
        self.linear
            .advance_effect_states(trace, &end.state, duration);
        let dual_duration = Dual {
            value: S::splat(duration),
            tangent: S::splat(1.0),
        };
        let (begin, target) = (from.torque.map(Dual::constant), target.map(Dual::constant));
        let torque = self
            .differentiable_current
            .over(&begin, &target, dual_duration);
        let torque = [torque.middle, torque.end].map(|row| row.map(|one| one.tangent));
        let by_length = StepLengthSensitivity::new(trace, &self.linear, torque, duration);
        let stops_instantly = |i: usize| plant.joints[i].settling_time.lane(0) == 0.0;
        let slides = |i: usize| from.modes.free[i].lane(0) != 0.0;
        let (requested, effects) = (&self.requested.config.joints, &self.linear.effects[..]);
        let half = self.linear.half;
        let margin = |joint| EventSensitivity::new(plant, requested, effects, &end, (joint, half));
        LinearisedSpan {
            is_stuck: std::array::from_fn(|i| stops_instantly(i) && !slides(i)),
            stops_motor: event.is_some_and(|(_, joint)| stops_instantly(joint) && slides(joint)),
            has_time_derivative: part > 0.0,
            decay: current.over(&[S::splat(1.0); N], &[S::splat(0.0); N], S::splat(duration)),
            duration,
            event: event.map(|(_, joint)| margin(joint)),
            rates: self
                .unforced
                .by_step_length(&self.linear, &by_length, duration),
            torque_rates: torque[1],
        }
    }
}

works! {
    ['c, 'a, A: Arm<N>, S: Lanes, V: Lanes, L: Lanes, G: Gears, const N: usize, const EFFECTS: bool]
    ['c, 'a, A, S, V, L, G, N, EFFECTS]
    /// [`VariationalSimulation::repeat_step`] in a separate scope, because it is rare and long.
    RepeatWork(0: &'c mut VariationalSimulation<'a, A, S, V, L, G, N, EFFECTS>) -> ()
        = VariationalSimulation::repeat_step;
}

works! {
    ['c, 'a, A: Arm<N>, S: Lanes, V: Lanes, G: Gears, const N: usize, const EFFECTS: bool]
    ['c, 'a, A, S, V, G, N, EFFECTS]
    /// [`BlockTrajectory::record`] in a separate scope, so that steps without a sample stay short.
    /// The number is that of the block's first direction.
    RecordWork(0: &'c BlockTrajectory<'a, A, S, V, G, N, EFFECTS>, 1: &'c [Quantity],
        2: &'c mut SampleBuffer, 3: usize, 4: &'c Response<V, N>) -> () = BlockTrajectory::record;
}
