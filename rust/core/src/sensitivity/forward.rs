//! One plain simulation with its sensitivities in blocks of directions.
//!
//! Smooth steps use [`crate::sensitivity::variational`]. So do the spans of a step between friction
//! events, with the derivatives of the events' times.

use std::marker::PhantomData;

use crate::actuation::current_loop::CurrentLoop;
use crate::arm::Arm;
use crate::experiment::simulate::Simulation;
use crate::experiment::{Diverged, Event, Member, Quantity, Source, Task, values};
use crate::joint::Joint;
use crate::joint::gear::Gears;
use crate::plant::friction::{Motion, Stretch};
use crate::plant::{Instant, Watch};
use crate::scalar::{Dual, Lanes, Work};
use crate::sensitivity::block_trajectory::{BlockTrajectory, Through};
use crate::sensitivity::event::EventSensitivity;
use crate::sensitivity::sample_buffer::SampleBuffer;
use crate::sensitivity::sensing::Sensing;
use crate::sensitivity::step_length::StepLengthSensitivity;
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensitivity::tangent_block::TangentBlock;
use crate::sensitivity::trace::Trace;
use crate::sensitivity::variational::Linearised;
use crate::sensitivity::{Sensitivities, decimated};
use crate::sensors::decimation::Decimation;

/// One arm with elastic gears, and derivatives in several directions: scalars `S`, `V::LANES`
/// directions per block, and lanes `L` for the stages of a step.
///
/// With `EFFECTS`, directions may be sizes of effects on motor, gear and link that the arm does not
/// have: `asked` is the arm with these effects at size zero. Otherwise `asked` is the arm itself.
pub(crate) struct ForwardSensitivity<'a, A, S, V, L, G, const N: usize, const EFFECTS: bool> {
    pub(crate) task: &'a Task<A, N>,
    pub(crate) member: &'a Member<'a, N>,
    pub(crate) asked: (&'a Task<A, N>, &'a Member<'a, N>),
    pub(crate) directions: &'a [Source],
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
        let mut chain = Chain::<'_, A, S, V, L, G, N, EFFECTS>::new(&self);
        for (step, event) in self.task.clock.instants() {
            chain.step(step, &event);
        }
        let Chain {
            nominal, buffer, ..
        } = chain;
        Ok(Sensitivities {
            values: decimated::<V, N>(values(&nominal.result()?), self.decimation),
            tangents: buffer.tangents,
        })
    }
}

struct Chain<
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
    asked: &'a Task<A, N>,
    nominal: Simulation<'a, A, S, G, N>,
    /// Whether voltages were commanded at the last step.
    commanded: bool,
    /// Whether any drive has a lag other than zero.
    lags: bool,
    /// Response without forcing by parameters.
    unforced: TangentBlock<S, N>,
    /// Current loops over a variable time.
    longer: CurrentLoop<Dual<S, S>, N>,
    trace: Trace<N>,
    linear: Linearised<A, L, G, N>,
    blocks: Vec<BlockTrajectory<'a, A, S, V, G, N, EFFECTS>>,
    /// The sensors that are recorded, if any.
    sensing: Option<Sensing<V, N>>,
    buffer: SampleBuffer<N>,
}

impl<'a, A: Arm<N>, S: Lanes, V: Lanes, L: Lanes, G: Gears, const N: usize, const EFFECTS: bool>
    Chain<'a, A, S, V, L, G, N, EFFECTS>
{
    fn new(of: &ForwardSensitivity<'a, A, S, V, L, G, N, EFFECTS>) -> Self {
        let (task, width) = (of.task, of.directions.len());
        let sizes = [task.record.len(), task.clock.samples, width, V::LANES];
        let (asked, member) = of.asked;
        let plain = |_, value| S::splat(value);
        let nominal = Simulation::new(task, of.member, &plain);
        let sensing = Sensing::new(task, nominal.sensors.as_ref());
        let trajectory = |first| {
            let directions = &of.directions[first..];
            BlockTrajectory::new(asked, member, directions, sensing.as_ref())
        };
        let lags = |joint: &Joint<S, G>| {
            let lag = joint.effects.drive_lag;
            lag.is_some_and(|lag| lag.time_constant.lane(0) != 0.0)
        };
        let linear = Linearised::new(
            &task.config,
            of.member.parameters,
            (&asked.config, member.parameters),
            &nominal.motion.state,
            task.clock.step,
        );
        Self {
            task,
            asked,
            lags: nominal.plant.joints.iter().any(lags),
            nominal,
            commanded: false,
            unforced: TangentBlock::new(&task.config, &[], Tangent::still()),
            longer: task.config.current_loop(task.clock.step),
            trace: Trace::new(task.config.joints.map(|joint| joint.ratio)),
            linear,
            blocks: (0..width).step_by(V::LANES).map(trajectory).collect(),
            sensing,
            buffer: SampleBuffer::new(sizes, of.decimation),
        }
    }

    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event);
        } else if EFFECTS && (self.commanded || self.lags) {
            // a lag of zero has settled one step after the command
            for trajectory in &mut self.blocks {
                trajectory.hold(&self.nominal.motion);
            }
            if self.lags {
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
            .update(&self.trace, &now.posture, &before.modes, h);
        self.propagate(event, &before, &now);
        if self.nominal.stretches.is_empty() {
            self.linear
                .passed(&self.trace, &self.nominal.motion.state, h);
        }
    }

    fn command(&mut self, step: usize, event: &Event) {
        for trajectory in &mut self.blocks {
            if trajectory.driven {
                trajectory.command(&self.nominal.motion, step, event.servo_reads);
            }
        }
        self.nominal.command(step, event.servo_reads);
    }

    /// Propagates the derivatives through an instant and the step that follows it.
    #[inline(always)]
    fn propagate(&mut self, event: &Event, before: &Motion<S, N>, now: &Instant<A, S, N>) {
        if let Some(sensing) = &mut self.sensing {
            sensing.take(&self.nominal.plant.arm, &before.state, now);
        }
        let smooth = !event.last && self.nominal.stretches.is_empty();
        let mut first = 0;
        for trajectory in &mut self.blocks {
            let x = trajectory.block.tangent;
            let torque = trajectory.driven.then_some(&trajectory.torque);
            let response = trajectory.block.respond(&self.linear, 0, &x, torque);
            if let (Some(sensing), Some(sensed)) = (&self.sensing, &mut trajectory.sensed) {
                sensed.sense::<A>(sensing, &x, &response);
            }
            if event.samples {
                V::scope(Put {
                    trajectory,
                    quantities: &self.task.record,
                    buffer: &mut self.buffer,
                    first,
                    response: &response,
                });
            }
            if smooth {
                trajectory.advance(&self.linear, &response);
            }
            first += V::LANES;
        }
        if event.samples {
            self.buffer.take::<V>();
        }
        if !event.last && !smooth {
            V::scope(Redo(self));
        }
    }

    /// Repeats a step with friction events, span by span.
    #[inline(always)]
    fn redo(&mut self) {
        for trajectory in &mut self.blocks {
            trajectory.left = V::splat(0.0);
        }
        for place in 0..self.nominal.stretches.len() {
            let stretch = self.nominal.stretches[place];
            let through = self.through(&stretch);
            for trajectory in &mut self.blocks {
                trajectory.pass(&self.linear, &through);
            }
        }
        for trajectory in &mut self.blocks {
            if !trajectory.driven {
                trajectory.torque = [V::splat(0.0); N];
            }
        }
    }

    /// Linearises a span for all blocks.
    #[inline(always)]
    fn through(&mut self, stretch: &Stretch<S, N>) -> Through<S, N> {
        let Stretch {
            from,
            length,
            event,
        } = stretch;
        let (nominal, trace) = (&self.nominal, &mut self.trace);
        let (plant, target) = (&nominal.plant, &nominal.target);
        let current = &nominal.current;
        let part = event.map_or(1.0, |event| event.0);
        let duration = part * length;
        let whole = (S::splat(*length), S::splat(part));
        let (end, _) = plant.retrace(from, target, current, whole, trace);
        let begin = plant.arm.posture(&from.state.link_angle);
        self.linear.update(trace, &begin, &from.modes, duration);
        self.linear.passed(trace, &end.state, duration);
        let lasting = Dual {
            value: S::splat(duration),
            tangent: S::splat(1.0),
        };
        let (begin, target) = (from.torque.map(Dual::constant), target.map(Dual::constant));
        let torque = self.longer.over(&begin, &target, lasting);
        let torque = [torque.middle, torque.end].map(|row| row.map(|one| one.tangent));
        let longer = StepLengthSensitivity::new(trace, &self.linear, torque, duration);
        let at_once = |i: usize| plant.joints[i].settling_time.lane(0) == 0.0;
        let slides = |i: usize| from.modes.free[i].lane(0) != 0.0;
        let (asked, effects) = (&self.asked.config.joints, self.linear.effects.as_ref());
        let half = self.linear.half;
        let margin =
            |joint| EventSensitivity::new(plant, &asked[joint], effects, &end, (joint, half));
        Through {
            rests: std::array::from_fn(|i| at_once(i) && !slides(i)),
            stops: event.is_some_and(|(_, joint)| at_once(joint) && slides(joint)),
            moves: part > 0.0,
            decay: current.over(&[S::splat(1.0); N], &[S::splat(0.0); N], S::splat(duration)),
            duration,
            event: event.map(|(_, joint)| margin(joint)),
            rates: self
                .unforced
                .by_step_length(&self.linear, &longer, duration),
            torque_rates: torque[1],
        }
    }
}

/// [`Chain::redo`] in a scope of its own, because it is rare and long.
struct Redo<
    'c,
    'a,
    A: Arm<N>,
    S: Lanes,
    V: Lanes,
    L: Lanes,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
>(&'c mut Chain<'a, A, S, V, L, G, N, EFFECTS>);

impl<A: Arm<N>, S: Lanes, V: Lanes, L: Lanes, G: Gears, const N: usize, const EFFECTS: bool> Work
    for Redo<'_, '_, A, S, V, L, G, N, EFFECTS>
{
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.redo();
    }
}

/// [`BlockTrajectory::record`] in a scope of its own, so that steps without a sample stay short.
struct Put<'c, 'a, A: Arm<N>, S: Lanes, V: Lanes, G: Gears, const N: usize, const EFFECTS: bool> {
    trajectory: &'c BlockTrajectory<'a, A, S, V, G, N, EFFECTS>,
    quantities: &'c [Quantity],
    buffer: &'c mut SampleBuffer<N>,
    /// Index of the block's first direction.
    first: usize,
    response: &'c Response<V, N>,
}

impl<A: Arm<N>, S: Lanes, V: Lanes, G: Gears, const N: usize, const EFFECTS: bool> Work
    for Put<'_, '_, A, S, V, G, N, EFFECTS>
{
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.trajectory
            .record(self.quantities, self.buffer, self.first, self.response);
    }
}
