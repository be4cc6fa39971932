//! One plain simulation, and derivatives that follow it in columns of directions.
//!
//! Smooth steps go through [`crate::variation`]; so do the stretches of a step between events of
//! friction, with what the events' instants do.

use std::marker::PhantomData;

use crate::arm::Arm;
use crate::collected::Collected;
use crate::column::{Column, Response, Tangent};
use crate::drive::CurrentLoop;
use crate::dual::Dual;
use crate::experiment::{Diverged, Event, Member, Quantity, Source, Task, values};
use crate::follower::{Follower, Through};
use crate::friction::{Motion, Stretch};
use crate::lengthening::Lengthening;
use crate::margin::MarginSlopes;
use crate::plant::{Instant, Watch};
use crate::real::{Lanes, Work};
use crate::sensing::Sensing;
use crate::sensitivity::{Sensitivities, thinned};
use crate::simulate::Group;
use crate::thinning::Thinning;
use crate::variation::{Linearised, Trace};

/// One arm with elastic gears, derivatives in some directions: scalars `S`, `V::LANES` directions
/// a column, and lanes `L` for the stages of a step side by side.
///
/// With `EFFECTS` the directions may be by the sizes of effects that the arm does not have:
/// `asked` is the arm with them at nothing, and is the arm itself otherwise.
pub(crate) struct Followed<'a, A, S, V, L, const N: usize, const EFFECTS: bool> {
    pub(crate) task: &'a Task<A, N>,
    pub(crate) member: &'a Member<'a, N>,
    pub(crate) asked: (&'a Task<A, N>, &'a Member<'a, N>),
    pub(crate) directions: &'a [Source],
    /// What becomes of the samples.
    pub(crate) thinning: Option<&'a Thinning>,
    pub(crate) scalars: PhantomData<(S, V, L)>,
}

impl<A: Arm<N>, S: Lanes<One = S>, V: Lanes, L: Lanes, const N: usize, const EFFECTS: bool> Work
    for Followed<'_, A, S, V, L, N, EFFECTS>
{
    type Output = Result<Sensitivities<N>, Diverged>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut chain = Chain::<'_, A, S, V, L, N, EFFECTS>::new(&self);
        for (step, event) in self.task.clock.instants() {
            chain.step(step, &event);
        }
        let Chain {
            nominal, collected, ..
        } = chain;
        let mut values_of = Vec::new();
        for record in nominal.results() {
            values_of = thinned::<V, N>(values(&record?), self.thinning);
        }
        Ok(Sensitivities {
            values: values_of,
            tangents: collected.tangents,
        })
    }
}

struct Chain<
    'a,
    A: Arm<N>,
    S: Lanes<One = S>,
    V: Lanes,
    L: Lanes,
    const N: usize,
    const EFFECTS: bool,
> {
    task: &'a Task<A, N>,
    asked: &'a Task<A, N>,
    nominal: Group<'a, A, S, N, true>,
    /// What no parameter forces.
    unforced: Column<S, N>,
    /// Current loops over times that get longer.
    longer: CurrentLoop<Dual<S, S>, N>,
    trace: Trace<N>,
    linear: Linearised<A, L, N>,
    followers: Vec<Follower<'a, A, S, V, N, EFFECTS>>,
    /// The sensors that are recorded, if any.
    sensing: Option<Sensing<V, N>>,
    collected: Collected<N>,
}

impl<'a, A: Arm<N>, S: Lanes<One = S>, V: Lanes, L: Lanes, const N: usize, const EFFECTS: bool>
    Chain<'a, A, S, V, L, N, EFFECTS>
{
    fn new(of: &Followed<'a, A, S, V, L, N, EFFECTS>) -> Self {
        let (task, width) = (of.task, of.directions.len());
        let sizes = [task.record.len(), task.clock.samples, width, V::LANES];
        let (asked, member) = of.asked;
        let plain = |_, value| S::splat(value);
        let nominal = Group::new(task, std::slice::from_ref(of.member), &plain);
        let sensing = Sensing::new(task, nominal.sensors.as_ref());
        let follower = |first| {
            let directions = &of.directions[first..];
            Follower::new(asked, member, directions, sensing.as_ref())
        };
        Self {
            task,
            asked,
            nominal,
            unforced: Column::new(&task.config, &[], Tangent::still()),
            longer: task.config.current_loop(task.clock.step),
            trace: Trace::new(task.config.joints.map(|joint| joint.ratio)),
            linear: Linearised::new(
                &task.config,
                of.member.parameters,
                (&asked.config, member.parameters),
                task.clock.step,
            ),
            followers: (0..width).step_by(V::LANES).map(follower).collect(),
            sensing,
            collected: Collected::new(sizes, of.thinning),
        }
    }

    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event);
        }
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
        self.follow(event, &before, &now);
        if let Some(onset) = &mut self.linear.onset
            && self.nominal.stretches.is_empty()
        {
            onset.passed(&self.trace, &self.nominal.motion.state, h);
        }
    }

    fn command(&mut self, step: usize, event: &Event) {
        if self.task.servo.is_some() {
            for follower in &mut self.followers {
                follower.command(&self.nominal.motion, step, event.servo_reads);
            }
        }
        self.nominal.command(step, event.servo_reads);
    }

    /// The derivatives' part of an instant and of the step that follows it.
    #[inline(always)]
    fn follow(&mut self, event: &Event, before: &Motion<S, N>, now: &Instant<A, S, N>) {
        if let Some(sensing) = &mut self.sensing {
            sensing.take(self.task, &before.state, now);
        }
        let smooth = !event.last && self.nominal.stretches.is_empty();
        let mut first = 0;
        for follower in &mut self.followers {
            let x = follower.column.tangent;
            let torque = follower.driven.then_some(&follower.torque);
            let response = follower.column.respond(&self.linear, 0, &x, torque);
            if let (Some(sensing), Some(sensed)) = (&self.sensing, &mut follower.sensed) {
                sensed.sense::<A>(sensing, &x, &response);
            }
            if event.samples {
                V::scope(Put {
                    follower,
                    quantities: &self.task.record,
                    collected: &mut self.collected,
                    first,
                    response: &response,
                });
            }
            if smooth {
                follower.advance(&self.linear, &response);
            }
            first += V::LANES;
        }
        if event.samples {
            self.collected.take::<V>();
        }
        if !event.last && !smooth {
            V::scope(Redo(self));
        }
    }

    /// A step in which friction changed its mode: from stretch to stretch.
    #[inline(always)]
    fn redo(&mut self) {
        for follower in &mut self.followers {
            follower.left = V::splat(0.0);
        }
        for place in 0..self.nominal.stretches.len() {
            let stretch = self.nominal.stretches[place];
            let through = self.through(&stretch);
            for follower in &mut self.followers {
                follower.pass(&self.linear, &through);
            }
        }
        for follower in &mut self.followers {
            if !follower.driven {
                follower.torque = [V::splat(0.0); N];
            }
        }
    }

    /// Goes through a stretch, for the columns to follow.
    #[inline(always)]
    fn through(&mut self, stretch: &Stretch<S, N>) -> Through<S, N> {
        let Stretch {
            from,
            length,
            event,
        } = stretch;
        let (nominal, trace) = (&self.nominal, &mut self.trace);
        let (plant, target) = (&nominal.plant, &nominal.target);
        let current = &nominal.single_current;
        let part = event.map_or(1.0, |event| event.0);
        let duration = part * length;
        let whole = (S::splat(*length), S::splat(part));
        let (end, _) = plant.retrace(from, target, current, whole, trace);
        let begin = A::posture(&from.state.link_angle);
        self.linear.update(trace, &begin, &from.modes, duration);
        if let Some(onset) = &mut self.linear.onset {
            onset.passed(trace, &end.state, duration);
        }
        let lasting = Dual {
            value: S::splat(duration),
            tangent: S::splat(1.0),
        };
        let (begin, target) = (from.torque.map(Dual::constant), target.map(Dual::constant));
        let torque = self.longer.over(&begin, &target, lasting);
        let torque = [torque.middle, torque.end].map(|row| row.map(|one| one.tangent));
        let longer = Lengthening::new(trace, &self.linear, torque, duration);
        let at_once = |i: usize| plant.joints[i].settling_time.lane(0) == 0.0;
        let slides = |i: usize| from.modes.free[i].lane(0) != 0.0;
        let (asked, onset) = (&self.asked.config.joints, self.linear.onset.as_ref());
        let half = self.linear.half;
        let margin = |joint| MarginSlopes::new(plant, &asked[joint], onset, &end, (joint, half));
        Through {
            rests: std::array::from_fn(|i| at_once(i) && !slides(i)),
            stops: event.is_some_and(|(_, joint)| at_once(joint) && slides(joint)),
            moves: part > 0.0,
            decay: current.over(&[S::splat(1.0); N], &[S::splat(0.0); N], S::splat(duration)),
            duration,
            event: event.map(|(_, joint)| margin(joint)),
            rates: self.unforced.lengthened(&self.linear, &longer, duration),
            torque_rates: torque[1],
        }
    }
}

/// [`Chain::redo`] in a scope of its own: it is rare, and long.
struct Redo<
    'c,
    'a,
    A: Arm<N>,
    S: Lanes<One = S>,
    V: Lanes,
    L: Lanes,
    const N: usize,
    const EFFECTS: bool,
>(&'c mut Chain<'a, A, S, V, L, N, EFFECTS>);

impl<A: Arm<N>, S: Lanes<One = S>, V: Lanes, L: Lanes, const N: usize, const EFFECTS: bool> Work
    for Redo<'_, '_, A, S, V, L, N, EFFECTS>
{
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.redo();
    }
}

/// [`Follower::record`] in a scope of its own: where few steps are sampled, it is not in their way.
struct Put<'c, 'a, A: Arm<N>, S: Lanes<One = S>, V: Lanes, const N: usize, const EFFECTS: bool> {
    follower: &'c Follower<'a, A, S, V, N, EFFECTS>,
    quantities: &'c [Quantity],
    collected: &'c mut Collected<N>,
    /// Of the column's directions.
    first: usize,
    response: &'c Response<V, N>,
}

impl<A: Arm<N>, S: Lanes<One = S>, V: Lanes, const N: usize, const EFFECTS: bool> Work
    for Put<'_, '_, A, S, V, N, EFFECTS>
{
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.follower
            .record(self.quantities, self.collected, self.first, self.response);
    }
}
