//! Simulation of several experiments at once, each in a lane of the registers.
//!
//! Lanes share the arithmetic of the steps. Commands and friction events differ, so each lane has a
//! simulation of its own for these; a step in which friction changes its mode is repeated there.

use std::marker::PhantomData;

use crate::arm::Arm;
use crate::experiment::simulate::{Simulation, has_held_motors};
use crate::experiment::{Clock, Diverged, Event, Record, Task};
use crate::joint::gear::Gears;
use crate::plant::Instant;
use crate::plant::friction::{Margins, Motion};
use crate::program::Case;
use crate::scalar::{Real, Work, in_lane, works};

/// Experiments on one arm without effects, whose clocks differ in the number of samples only and
/// which record the same quantities: at most `V::LANES`, with a scalar `S` for each alone.
pub struct SimulateTogether<'a, A, S, V, G, const N: usize> {
    experiments: &'a [Case<'a, A, N>],
    scalars: PhantomData<(S, V, G)>,
}

impl<'a, A, S, V, G, const N: usize> SimulateTogether<'a, A, S, V, G, N> {
    /// # Panics
    /// There is none, or not each of them [`can_share`] a simulation with the first.
    pub fn new(experiments: &'a [Case<'a, A, N>]) -> Self {
        let (first, _) = &experiments[0];
        assert!(experiments.iter().all(|(task, _)| can_share(first, task)));
        Self {
            experiments,
            scalars: PhantomData,
        }
    }
}

/// Relative difference of steps that are equal but for rounding.
const STEP_ROUNDING: f64 = 1e-12;

/// Whether two experiments on one arm can be simulated together. Steps that differ by rounding are
/// equal.
pub fn can_share<A, const N: usize>(one: &Task<A, N>, other: &Task<A, N>) -> bool {
    let Clock { step, samples, .. } = one.clock;
    let alike = Clock {
        step,
        samples,
        ..other.clock
    };
    let is_equal = (other.clock.step - step).abs() < STEP_ROUNDING * step && one.clock == alike;
    is_equal && one.record == other.record && one.link_sensors == other.link_sensors
}

impl<A: Arm<N>, S: Real, V: Real, G: Gears, const N: usize> Work
    for SimulateTogether<'_, A, S, V, G, N>
{
    type Output = Vec<Result<Record<N>, Diverged>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut together = Together::<A, S, V, G, N>::new(self.experiments);
        for (step, event) in together.task.clock.instants() {
            together.step(step, &event);
        }
        let lanes = together.lanes.iter().enumerate();
        lanes
            .map(|(l, lane)| together.all.lane_result(l, &lane.task.clock))
            .collect()
    }
}

struct Together<'a, A: Arm<N>, S: Real, V: Real, G: Gears, const N: usize> {
    /// The longest task.
    task: &'a Task<A, N>,
    all: Simulation<'a, A, V, G, N>,
    lanes: Vec<Simulation<'a, A, S, G, N>>,
}

impl<'a, A: Arm<N>, S: Real, V: Real, G: Gears, const N: usize> Together<'a, A, S, V, G, N> {
    fn new(experiments: &'a [Case<'a, A, N>]) -> Self {
        assert!(experiments.len() <= V::LANES);
        let alone = |(task, member): &'a Case<'a, A, N>| {
            Simulation::<A, S, G, N>::new(task, member, &|_, value| S::splat(value))
        };
        let lanes: Vec<_> = experiments.iter().map(alone).collect();
        let by_length = |experiment: &&Case<'_, A, N>| experiment.0.clock.samples;
        let (task, member) = experiments.iter().max_by_key(by_length).expect("one");
        // lanes without an experiment repeat the last one
        let from = |value: &dyn Fn(usize) -> f64| {
            let mut all = V::splat(value(experiments.len() - 1));
            for l in 0..experiments.len() {
                all.set_lane(l, value(l));
            }
            all
        };
        let plant = task
            .config
            .plant_of(|k| from(&|l| experiments[l].1.parameters[k]));
        let mut motion = Motion::zero();
        for l in 0..V::LANES {
            motion.set_lane(l, &lanes[l.min(lanes.len() - 1)].motion);
        }
        let voltage = std::array::from_fn(|i| from(&|l| lanes[l].voltage[i].lane(0)));
        Self {
            task,
            all: Simulation::from_motion(
                task,
                member,
                (plant, task.config.current_loop(task.clock.step)),
                motion,
                voltage,
            ),
            lanes,
        }
    }

    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event.servo_reads);
        }
        let now = self.all.instant();
        self.all.sense(&now);
        if event.samples {
            self.all.record(step, &now);
        }
        if !event.last {
            self.advance(step, &now);
        }
    }

    /// As [`Simulation::command`].
    fn command(&mut self, step: usize, servo_reads: bool) {
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            if step > lane.task.clock.steps() {
                continue;
            }
            if lane.task.servo.is_some() {
                lane.motion.state.motor_angle = in_lane(&self.all.motion.state.motor_angle, l);
            }
            S::scope(VoltageWork(lane, step, servo_reads));
            for i in 0..N {
                self.all.voltage[i].set_lane(l, lane.voltage[i].lane(0));
            }
        }
        V::scope(TargetWork(&mut self.all));
        if self.all.has_held_motors {
            self.release();
        }
    }

    /// As [`Simulation::release`].
    fn release(&mut self) {
        let Motion {
            state,
            torque,
            modes,
        } = &self.all.motion;
        let reserve = self.all.plant.smallest_reserve(state, torque, modes);
        if !reserve.any_negative() {
            return;
        }
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            if reserve.lane(l) < 0.0 {
                lane.motion = self.all.motion.lane(l);
                lane.release();
                self.all.motion.set_lane(l, &lane.motion);
            }
        }
        self.all.has_held_motors = has_held_motors(&self.all.motion);
    }

    /// As [`Simulation::advance`].
    #[inline(always)]
    fn advance(&mut self, step: usize, now: &Instant<A, V, N>) {
        let (state, torque, margins) = self.all.smooth_step(now, &mut ());
        let smallest = margins.smallest();
        let ends_mode = smallest.any_negative();
        if ends_mode {
            self.repeat_steps(step, smallest, &margins);
        }
        self.all.motion.state.copy_from::<false>(&state);
        self.all.motion.torque = torque;
        if ends_mode {
            self.replace_repeated(step, smallest);
        }
    }

    /// Repeats the step of each lane whose smallest margin is negative.
    #[inline(never)]
    fn repeat_steps(&mut self, step: usize, smallest: V, margins: &Margins<V, N>) {
        for (l, lane) in self.lanes.iter_mut().enumerate() {
            if smallest.lane(l) < 0.0 && step < lane.task.clock.steps() {
                lane.motion = self.all.motion.lane(l);
                lane.target = in_lane(&self.all.target, l);
                lane.repeat_step(&margins.lane(l));
            }
        }
    }

    /// Replaces what [`Self::repeat_steps`] has repeated.
    #[inline(never)]
    fn replace_repeated(&mut self, step: usize, smallest: V) {
        for (l, lane) in self.lanes.iter().enumerate() {
            if smallest.lane(l) < 0.0 && step < lane.task.clock.steps() {
                self.all.motion.set_lane(l, &lane.motion);
            }
        }
        self.all.has_held_motors = has_held_motors(&self.all.motion);
    }
}

works! {
    ['g, 'a, A: Arm<N>, S: Real, G: Gears, const N: usize]
    ['g, 'a, A, S, G, N]
    /// [`Simulation::set_voltage`].
    VoltageWork(0: &'g mut Simulation<'a, A, S, G, N>, 1: usize, 2: bool) -> ()
        = Simulation::set_voltage;
    /// [`Simulation::set_targets`].
    TargetWork(0: &'g mut Simulation<'a, A, S, G, N>) -> () = Simulation::set_targets;
}
