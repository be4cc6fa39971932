//! Simulation of one experiment. Inputs are voltages and references; outputs are motor, link and
//! sensor signals.

use std::marker::PhantomData;

use crate::actuation::Controller;
use crate::actuation::controller::ServoMemory;
use crate::actuation::current_loop::CurrentLoop;
use crate::arm::Arm;
use crate::experiment::start::start;
use crate::experiment::{Clock, Diverged, Event, Member, Quantity, Record, RecordOf, Source, Task};
use crate::joint::Joint;
use crate::joint::gear::Gears;
use crate::plant::friction::{Margins, Motion, Span, sign};
use crate::plant::{Instant, Plant, State, Watch};
use crate::scalar::{MAX_LANES, Real, Work, works};
use crate::sensors::encoder::encoder_angle;
use crate::sensors::link_sensors::Sensors;

/// Simulation over scalars `S` of one lane, as work for [`Real::scope`].
pub struct Simulate<'a, A, S, F, G: Gears, const N: usize, const EFFECTS: bool = false> {
    task: &'a Task<A, N>,
    member: &'a Member<'a, N>,
    lift: F,
    scalar: PhantomData<(S, G)>,
}

impl<'a, A: Arm<N>, S: Real, F, G: Gears, const N: usize, const EFFECTS: bool>
    Simulate<'a, A, S, F, G, N, EFFECTS>
where
    F: Fn(Source, f64) -> S,
{
    /// `lift` converts the value of a parameter or an initial state to a scalar, with derivatives
    /// if the scalar has them.
    pub fn new(task: &'a Task<A, N>, member: &'a Member<'a, N>, lift: F) -> Self {
        Self {
            task,
            member,
            lift,
            scalar: PhantomData,
        }
    }
}

impl<A: Arm<N>, S: Real, F, G: Gears, const N: usize, const EFFECTS: bool> Work
    for Simulate<'_, A, S, F, G, N, EFFECTS>
where
    F: Fn(Source, f64) -> S,
{
    type Output = Result<RecordOf<S, N>, Diverged>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut simulation: Simulation<'_, A, S, G, N, EFFECTS> =
            Simulation::new(self.task, self.member, &self.lift);
        for (step, event) in self.task.clock.instants() {
            simulation.step(step, &event);
        }
        simulation.result()
    }
}

/// State of a simulation, or of one per lane.
pub(crate) struct Simulation<
    'a,
    A: Arm<N>,
    S: Real,
    G: Gears,
    const N: usize,
    const EFFECTS: bool = false,
> {
    pub(crate) task: &'a Task<A, N>,
    member: &'a Member<'a, N>,
    pub(crate) plant: Plant<A, S, G, N, EFFECTS>,
    pub(crate) current: CurrentLoop<S, N>,
    pub(crate) motion: Motion<S, N>,
    pub(crate) has_held_motors: bool,
    pub(crate) target: [S; N],
    pub(crate) voltage: [S; N],
    /// State [V] of the lag of each drive.
    drive_state: [S; N],
    /// Whether any drive has a lag.
    pub(crate) has_drive_lag: bool,
    servo: Option<ServoMemory<S, N>>,
    pub(crate) sensors: Option<Sensors<S, N>>,
    /// Spans between the friction events of the last step; empty without events.
    pub(crate) spans: Vec<Span<S, N>>,
    record: RecordOf<S, N>,
    /// Of each lane.
    diverged: [Option<Diverged>; MAX_LANES],
}

impl<'a, A: Arm<N>, S: Real, G: Gears, const N: usize, const EFFECTS: bool>
    Simulation<'a, A, S, G, N, EFFECTS>
{
    pub(crate) fn new(
        task: &'a Task<A, N>,
        member: &'a Member<'a, N>,
        lift: &impl Fn(Source, f64) -> S,
    ) -> Self {
        const { assert!(S::LANES == 1) };
        let parameter = |k| lift(Source::Parameter(k), member.parameters[k]);
        let plant = task.config.plant_of(parameter);
        let current = task.config.current_loop(task.clock.step);
        let motion = start(&plant, &current, &member.initial, lift);
        let voltage = member.initial.voltage.map(S::splat);
        let mut simulation = Self::from_motion(task, member, (plant, current), motion, voltage);
        if let Some(servo) = &task.servo {
            let encoder = encoder_of(task, &simulation.motion);
            simulation.servo = Some(servo.at_rest(&member.initial.voltage, &encoder));
        }
        simulation
    }

    /// A simulation without servo from a motion at a voltage [V].
    pub(crate) fn from_motion(
        task: &'a Task<A, N>,
        member: &'a Member<'a, N>,
        (plant, current): (Plant<A, S, G, N, EFFECTS>, CurrentLoop<S, N>),
        motion: Motion<S, N>,
        voltage: [S; N],
    ) -> Self {
        let effective_voltage =
            std::array::from_fn(|i| plant.joints[i].effective_voltage(voltage[i]));
        let lag = |joint: &Joint<S, G>| joint.effects.drive_lag.is_some();
        let mut simulation = Self {
            task,
            member,
            has_drive_lag: plant.joints.iter().any(lag),
            plant,
            current,
            has_held_motors: has_held_motors(&motion),
            target: motion.torque,
            motion,
            voltage,
            drive_state: effective_voltage,
            servo: None,
            sensors: None,
            spans: Vec::new(),
            record: vec![Vec::with_capacity(task.clock.samples); task.record.len()],
            diverged: [None; MAX_LANES],
        };
        let (arm, state) = (&simulation.plant.arm, &simulation.motion.state);
        simulation.sensors = Sensors::at_rest(task, arm, state, &simulation.instant());
        simulation
    }

    /// Advances by one instant and the step that follows it.
    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event.servo_reads);
        } else if self.has_drive_lag {
            self.hold();
        }
        let now = self.instant();
        self.sense(&now);
        if event.samples {
            self.record(step, &now);
        }
        if !event.last {
            self.advance(&now, &mut ());
        }
    }

    #[inline(always)]
    pub(crate) fn instant(&self) -> Instant<A, S, N> {
        let motion = &self.motion;
        self.plant
            .instant(&motion.state, &motion.torque, &motion.modes)
    }

    /// Applies the voltages of this instant: the feed-forward of the tick, and the servo's output
    /// if the servo reads.
    pub(crate) fn command(&mut self, step: usize, servo_reads: bool) {
        S::scope(CommandWork(self, step, servo_reads));
    }

    #[inline(always)]
    fn apply_command(&mut self, step: usize, servo_reads: bool) {
        self.set_voltage(step, servo_reads);
        self.hold();
    }

    /// Sets the voltages of this instant.
    #[inline(always)]
    pub(crate) fn set_voltage(&mut self, step: usize, servo_reads: bool) {
        let tick = step / self.task.clock.steps_per_tick;
        let feed_forward = &self.member.feed_forward[tick];
        match (&self.task.servo, &mut self.servo) {
            (Some(servo), Some(memory)) if servo_reads => {
                let reference = &self.member.reference[tick];
                let encoder = encoder_of(self.task, &self.motion);
                self.voltage = servo.command(memory, reference, &encoder, feed_forward);
            }
            (Some(servo), _) => {
                for i in 0..N {
                    if !servo.drives(i) {
                        self.voltage[i] = S::splat(feed_forward[i]);
                    }
                }
            }
            (None, _) => self.voltage = feed_forward.map(S::splat),
        }
    }

    /// Sets the target torques of the next step, and releases motors that these move.
    #[inline(always)]
    pub(crate) fn hold(&mut self) {
        self.set_targets();
        if self.has_held_motors {
            self.release();
        }
    }

    /// Sets the target torques of the next step.
    #[inline(always)]
    pub(crate) fn set_targets(&mut self) {
        for i in 0..N {
            let joint = &self.plant.joints[i];
            let effective_voltage = joint.effective_voltage(self.voltage[i]);
            let memory = &mut self.drive_state[i];
            let held = joint.hold_voltage(effective_voltage, memory, self.task.clock.step);
            let torque = held * self.current.torque_per_volt[i];
            self.target[i] = torque;
            if self.current.bandwidth[i].is_infinite() {
                self.motion.torque[i] = torque;
            }
        }
    }

    /// Releases sticking motors whose torque has jumped beyond the friction limit.
    pub(crate) fn release(&mut self) {
        let Motion {
            state,
            torque,
            modes,
        } = &mut self.motion;
        self.plant.release(state, torque, modes);
        self.has_held_motors = has_held_motors(&self.motion);
    }

    /// Advances by one integrator step. A step in which friction changes its mode is repeated event
    /// by event.
    #[inline(always)]
    pub(crate) fn advance(&mut self, now: &Instant<A, S, N>, watch: &mut impl Watch<S, N>) {
        let (state, torque, margins) = self.smooth_step(now, watch);
        if margins.smallest().any_negative() {
            self.repeat_step(&margins);
        } else {
            self.spans.clear();
            self.motion.state.copy_from::<EFFECTS>(&state);
            self.motion.torque = torque;
        }
    }

    /// State and torques after a step with unchanged modes, and the margins of these.
    #[inline(always)]
    pub(crate) fn smooth_step(
        &self,
        now: &Instant<A, S, N>,
        watch: &mut impl Watch<S, N>,
    ) -> (State<S, N>, [S; N], Margins<S, N>) {
        let torque = self.current.over_step(&self.motion.torque, &self.target);
        let h = S::splat(self.task.clock.step);
        let modes = &self.motion.modes;
        let state = self
            .plant
            .runge_kutta(&self.motion.state, now, &torque, modes, h, watch);
        let margins = self
            .plant
            .margins(&state, &torque.end, modes, self.has_held_motors);
        (state, torque.end, margins)
    }

    #[inline(never)]
    pub(crate) fn repeat_step(&mut self, margins: &Margins<S, N>) {
        self.spans.clear();
        self.motion = self.plant.advance(
            &self.motion,
            margins,
            &self.target,
            &self.current,
            self.task.clock.step,
            &mut self.spans,
        );
        self.has_held_motors = has_held_motors(&self.motion);
    }

    #[inline(always)]
    pub(crate) fn sense(&mut self, now: &Instant<A, S, N>) {
        if let Some(sensors) = &mut self.sensors {
            sensors.update(self.task, &self.plant.arm, &self.motion.state, now);
        }
    }

    #[inline(never)]
    pub(crate) fn record(&mut self, step: usize, now: &Instant<A, S, N>) {
        S::scope(RecordWork(self, step, now));
    }

    #[inline(always)]
    fn record_all(&mut self, step: usize, now: &Instant<A, S, N>) {
        let state = &self.motion.state;
        for k in 0..self.task.record.len() {
            let row = match self.task.record[k] {
                Quantity::Voltage => self.voltage,
                Quantity::MotorTorque => self.motion.torque,
                Quantity::MotorAngle => state.motor_angle,
                Quantity::MotorVelocity => state.motor_velocity,
                Quantity::LinkAngle => state.link_angle,
                Quantity::LinkVelocity => state.link_velocity,
                Quantity::LinkAcceleration => now.acceleration.link,
                Quantity::GearTorque => self.plant.gear_torques(state),
                Quantity::Torsion => self.plant.torsions(state),
                Quantity::Encoder => encoder_of(self.task, &self.motion),
                Quantity::Accelerometer => self.reading(0),
                Quantity::Gyro => self.reading(1),
                Quantity::LinkSensor(k) => self.link_readings(k),
                Quantity::Sliding => state.motor_velocity.map(signs),
            };
            self.record[k].push(row);
        }
        self.check_finite(step);
    }

    #[inline(always)]
    fn reading(&self, kind: usize) -> [S; N] {
        match &self.sensors {
            Some(sensors) => sensors.readings[kind],
            None => [S::splat(0.0); N],
        }
    }

    #[inline(always)]
    fn link_readings(&self, sensor: usize) -> [S; N] {
        match &self.sensors {
            Some(sensors) => sensors.imu_readings[sensor],
            None => [S::splat(0.0); N],
        }
    }

    #[inline(always)]
    fn check_finite(&mut self, step: usize) {
        let state = &self.motion.state;
        for lane in 0..S::LANES {
            let sum = (0..N)
                .map(|i| state.motor_velocity[i].lane(lane) + state.link_velocity[i].lane(lane))
                .sum::<f64>();
            if !sum.is_finite() && self.diverged[lane].is_none() {
                let time = step as f64 * self.task.clock.step;
                self.diverged[lane] = Some(Diverged { time });
            }
        }
    }

    pub(crate) fn result(self) -> Result<RecordOf<S, N>, Diverged> {
        self.diverged[0].map_or(Ok(self.record), Err)
    }

    /// Result in one lane, up to the end of a clock.
    pub(crate) fn lane_result(&self, lane: usize, clock: &Clock) -> Result<Record<N>, Diverged> {
        let end = clock.steps() as f64 * clock.step;
        if let Some(diverged) = self.diverged[lane].filter(|one| one.time <= end) {
            return Err(diverged);
        }
        let row = |row: &[S; N]| row.map(|value| value.lane(lane));
        let rows = |rows: &Vec<[S; N]>| rows[..clock.samples].iter().map(row).collect();
        Ok(self.record.iter().map(rows).collect())
    }
}

works! {
    ['g, 'a, A: Arm<N>, S: Real, G: Gears, const N: usize, const EFFECTS: bool]
    ['g, 'a, A, S, G, N, EFFECTS]
    /// [`Simulation::record`] in the scope of its scalar. Outside of it, operations that the compiler
    /// moves out of the loop would be calls.
    RecordWork(0: &'g mut Simulation<'a, A, S, G, N, EFFECTS>, 1: usize, 2: &'g Instant<A, S, N>) -> ()
        = Simulation::record_all;
    /// [`Simulation::command`].
    CommandWork(0: &'g mut Simulation<'a, A, S, G, N, EFFECTS>, 1: usize, 2: bool) -> ()
        = Simulation::apply_command;
}

/// Encoder readings [rad].
#[inline(always)]
fn encoder_of<A, S: Real, const N: usize>(task: &Task<A, N>, motion: &Motion<S, N>) -> [S; N] {
    let mut readings = motion.state.motor_angle;
    for i in 0..N {
        readings[i] = encoder_angle(readings[i], task.config.joints[i].encoder_counts);
    }
    readings
}

/// Whether friction holds any motor.
pub(crate) fn has_held_motors<S: Real, const N: usize>(motion: &Motion<S, N>) -> bool {
    motion
        .modes
        .free
        .iter()
        .any(|&free| (free - 0.5).any_negative())
}

/// +1, -1 or 0 in each lane, without derivatives.
fn signs<S: Real>(numbers: S) -> S {
    let mut all = S::splat(0.0);
    for lane in 0..S::LANES {
        all.set_lane(lane, sign::<f64>(numbers.lane(lane)));
    }
    all
}
