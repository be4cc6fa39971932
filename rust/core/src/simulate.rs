//! Whole experiments: voltages and references in, what motors, links and sensors did out.

use std::marker::PhantomData;

use crate::arm::Arm;
use crate::config::{Config, gather};
use crate::drive::{CurrentLoop, Servo, ServoState, encoder_angle};
use crate::friction::{Motion, Stretch, sign};
use crate::plant::{Instant, Plant, State, Watch};
use crate::real::{Real, Work};
use crate::sensors::LowPass;

/// What can be recorded, each a value per joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// u [V], as applied from this instant on.
    Voltage,
    /// Torque of the motor [N m].
    MotorTorque,
    /// theta_M [rad].
    MotorAngle,
    /// dtheta_M [rad/s].
    MotorVelocity,
    /// theta_L [rad].
    LinkAngle,
    /// dtheta_L [rad/s].
    LinkVelocity,
    /// ddtheta_L [rad/s^2].
    LinkAcceleration,
    /// Torque [N m] each gear passes to its link; zero for a rigid gear.
    GearTorque,
    /// Encoder reading [rad].
    Encoder,
    /// Accelerometer reading [m/s^2], after its bandwidth.
    Accelerometer,
    /// Gyro reading [rad/s], after its bandwidth.
    Gyro,
    /// 0 where the motor stands still by friction, else the sign of its motion.
    Sliding,
}

/// How time is cut: everything happens at multiples of the integrator's step.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// Step of the integrator [s].
    pub step: f64,
    /// Steps from one voltage of the feed-forward to the next.
    pub steps_per_tick: usize,
    /// Steps from one servo reading to the next.
    pub steps_per_servo: usize,
    /// Steps from one recorded sample to the next.
    pub steps_per_sample: usize,
    /// Samples to record; the first is at time zero.
    pub samples: usize,
}

impl Clock {
    /// Steps from the first sample to the last.
    pub fn steps(&self) -> usize {
        self.samples.saturating_sub(1) * self.steps_per_sample
    }

    /// Ticks the feed-forward and the reference must hold.
    pub fn ticks(&self) -> usize {
        self.steps() / self.steps_per_tick + 1
    }

    /// Every instant, and what is to be done there.
    pub(crate) fn instants(&self) -> Instants {
        Instants {
            clock: *self,
            step: 0,
            to_tick: 0,
            to_servo: 0,
            to_sample: 0,
        }
    }
}

/// A clock on its way; it counts down, which is cheaper than to divide at every step.
pub(crate) struct Instants {
    clock: Clock,
    step: usize,
    to_tick: usize,
    to_servo: usize,
    to_sample: usize,
}

impl Iterator for Instants {
    type Item = (usize, Event);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, Event)> {
        let (step, steps) = (self.step, self.clock.steps());
        if step > steps {
            return None;
        }
        let event = Event {
            commands: self.to_tick == 0 || self.to_servo == 0,
            servo_reads: self.to_servo == 0,
            samples: self.to_sample == 0,
            last: step == steps,
        };
        let next = |left: usize, period: usize| if left == 0 { period - 1 } else { left - 1 };
        self.to_tick = next(self.to_tick, self.clock.steps_per_tick);
        self.to_servo = next(self.to_servo, self.clock.steps_per_servo);
        self.to_sample = next(self.to_sample, self.clock.steps_per_sample);
        self.step += 1;
        Some((step, event))
    }
}

/// How an experiment begins.
#[derive(Clone, Copy, Debug)]
pub struct Initial<const N: usize> {
    /// theta_M [rad].
    pub motor_angle: [f64; N],
    /// dtheta_M [rad/s].
    pub motor_velocity: [f64; N],
    /// theta_L [rad]; `None`: where the links hang at rest on their gears.
    pub link_angle: Option<[f64; N]>,
    /// dtheta_L [rad/s].
    pub link_velocity: [f64; N],
    /// Voltage [V] that has been there long enough for the torque to have followed.
    pub voltage: [f64; N],
}

/// One arm in one experiment.
#[derive(Clone, Copy, Debug)]
pub struct Member<'a, const N: usize> {
    /// Parameter values, in the order of [`Config::parameter_names`].
    pub parameters: &'a [f64],
    /// Voltage [V] per tick, added to the servo's.
    pub feed_forward: &'a [[f64; N]],
    /// Servo reference [rad/s] per tick.
    pub reference: &'a [[f64; N]],
    /// How it begins.
    pub initial: Initial<N>,
}

/// What is common to all arms of a batch.
#[derive(Clone, Debug)]
pub struct Task<A, const N: usize> {
    /// The arm's known constants.
    pub config: Config<A, N>,
    /// How time is cut.
    pub clock: Clock,
    /// The servo; `None`: every joint gets its feed-forward voltage.
    pub servo: Option<Servo<N>>,
    /// What to record.
    pub record: Vec<Quantity>,
}

/// What was recorded: for each quantity of the task, samples times joints.
pub type Record<const N: usize> = RecordOf<f64, N>;

/// A record of numbers of any kind.
pub type RecordOf<S, const N: usize> = Vec<Vec<[S; N]>>;

/// The plain numbers of a record.
pub fn values<S: Real, const N: usize>(record: &RecordOf<S, N>) -> Record<N> {
    let plain = |row: &[S; N]| row.map(|value| value.lane(0));
    record
        .iter()
        .map(|rows| rows.iter().map(plain).collect())
        .collect()
}

/// A number that a motion depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The parameter of this place in [`Config::parameter_names`].
    Parameter(usize),
    /// A joint's first motor angle.
    MotorAngle(usize),
    /// A joint's first motor velocity.
    MotorVelocity(usize),
    /// A joint's first link angle, or what is added to the angle where it hangs.
    LinkAngle(usize),
    /// A joint's first link velocity.
    LinkVelocity(usize),
}

/// A motion that left the finite numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diverged {
    /// When [s].
    pub time: f64,
}

/// Arms to be run side by side, a multiple of `R::LANES`. Steps of single lanes in which friction
/// changes its mode are redone on `R::One`.
///
/// Groups of `R::LANES` take turns at every step: while one waits for its own last result, the
/// processor is already at the next one's operations.
pub struct SideBySide<'a, A, R, G, const N: usize, const ELASTIC: bool> {
    task: &'a Task<A, N>,
    members: &'a [Member<'a, N>],
    given: G,
    scalar: PhantomData<R>,
}

impl<'a, A: Arm<N>, R: Real, G, const N: usize, const ELASTIC: bool>
    SideBySide<'a, A, R, G, N, ELASTIC>
where
    G: Fn(Source, f64) -> R::One,
{
    /// A multiple of `R::LANES` members, and how a number that a motion depends on is to be had
    /// from its value.
    pub fn new(task: &'a Task<A, N>, members: &'a [Member<'a, N>], given: G) -> Self {
        Self {
            task,
            members,
            given,
            scalar: PhantomData,
        }
    }
}

impl<A: Arm<N>, R: Real, G, const N: usize, const ELASTIC: bool> Work
    for SideBySide<'_, A, R, G, N, ELASTIC>
where
    G: Fn(Source, f64) -> R::One,
{
    type Output = Vec<Result<RecordOf<R::One, N>, Diverged>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut groups: Vec<Group<'_, A, R, N, ELASTIC>> = self
            .members
            .chunks(R::LANES)
            .map(|members| Group::new(self.task, members, &self.given))
            .collect();
        for (step, event) in self.task.clock.instants() {
            for group in &mut groups {
                group.step(step, &event);
            }
        }
        groups.into_iter().flat_map(Group::results).collect()
    }
}

/// What the clock asks for at one step.
pub(crate) struct Event {
    pub(crate) commands: bool,
    pub(crate) servo_reads: bool,
    pub(crate) samples: bool,
    pub(crate) last: bool,
}

/// Arms that run side by side.
pub(crate) struct Group<'a, A: Arm<N>, R: Real, const N: usize, const ELASTIC: bool> {
    task: &'a Task<A, N>,
    members: &'a [Member<'a, N>],
    pub(crate) plant: Plant<A, R, N, ELASTIC>,
    current: CurrentLoop<R, N>,
    pub(crate) single: Vec<Plant<A, R::One, N, ELASTIC>>,
    pub(crate) single_current: CurrentLoop<R::One, N>,
    pub(crate) motion: Motion<R, N>,
    standing: bool,
    pub(crate) target: [R; N],
    pub(crate) voltage: Vec<[R::One; N]>,
    servo: Vec<ServoState<R::One, N>>,
    pub(crate) sensors: Option<Sensors<R, N>>,
    /// What friction's events cut the last step into, for the last lane that had any.
    pub(crate) stretches: Vec<Stretch<R::One, N>>,
    records: Vec<RecordOf<R::One, N>>,
    diverged: Vec<Option<Diverged>>,
}

/// The sensors with a memory, one of each kind a joint.
pub(crate) struct Sensors<R, const N: usize> {
    pub(crate) accelerometer: [Option<LowPass<R, 2>>; N],
    pub(crate) gyro: [Option<LowPass<R, 1>>; N],
    readings: [[R; N]; 2],
}

impl<'a, A: Arm<N>, R: Real, const N: usize, const ELASTIC: bool> Group<'a, A, R, N, ELASTIC> {
    pub(crate) fn new(
        task: &'a Task<A, N>,
        members: &'a [Member<'a, N>],
        given: &impl Fn(Source, f64) -> R::One,
    ) -> Self {
        assert_eq!(members.len(), R::LANES);
        let step = task.clock.step;
        let parameter = |lane: usize, k| given(Source::Parameter(k), members[lane].parameters[k]);
        let single: Vec<Plant<A, R::One, N, ELASTIC>> = (0..R::LANES)
            .map(|lane| task.config.plant_of(|k| parameter(lane, k)))
            .collect();
        let single_current = task.config.current_loop(step);
        let starts: Vec<Motion<R::One, N>> = members
            .iter()
            .zip(&single)
            .map(|(member, plant)| start(plant, &single_current, &member.initial, given))
            .collect();
        let motion = side_by_side(&starts);
        let mut group = Self {
            task,
            members,
            plant: task.config.plant_of(|k| gather(|lane| parameter(lane, k))),
            current: task.config.current_loop(step),
            single,
            single_current,
            standing: any_standing(&motion),
            target: motion.torque,
            motion,
            voltage: members
                .iter()
                .map(|member| member.initial.voltage.map(R::One::splat))
                .collect(),
            servo: members
                .iter()
                .zip(&starts)
                .map(|(member, start)| member.servo_at_rest(task, &start.state.motor_angle))
                .collect(),
            sensors: None,
            stretches: Vec::new(),
            records: vec![
                vec![Vec::with_capacity(task.clock.samples); task.record.len()];
                R::LANES
            ],
            diverged: vec![None; R::LANES],
        };
        let senses = |quantity| task.record.contains(&quantity);
        if senses(Quantity::Accelerometer) || senses(Quantity::Gyro) {
            group.sensors = Some(group.sensors_at_rest());
        }
        group
    }

    /// What happens at one instant, and the step that follows it.
    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event.servo_reads);
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
    pub(crate) fn instant(&self) -> Instant<A, R, N> {
        let motion = &self.motion;
        self.plant
            .instant(&motion.state, &motion.torque, &motion.modes)
    }

    /// Takes in the voltages of this instant: the tick's feed-forward, and the servo where it reads.
    pub(crate) fn command(&mut self, step: usize, servo_reads: bool) {
        let tick = step / self.task.clock.steps_per_tick;
        for lane in 0..R::LANES {
            let member = &self.members[lane];
            let feed_forward = &member.feed_forward[tick];
            let voltage = &mut self.voltage[lane];
            match &self.task.servo {
                Some(servo) if servo_reads => {
                    let encoder = std::array::from_fn(|i| {
                        let angle = self.motion.state.motor_angle[i].one(lane);
                        encoder_angle(angle, self.task.config.joints[i].encoder_counts)
                    });
                    let reference = &member.reference[tick];
                    *voltage =
                        servo.command(&mut self.servo[lane], reference, &encoder, feed_forward);
                }
                Some(servo) => {
                    for i in 0..N {
                        if !servo.active[i] {
                            voltage[i] = R::One::splat(feed_forward[i]);
                        }
                    }
                }
                None => *voltage = feed_forward.map(R::One::splat),
            }
            for i in 0..N {
                let torque = R::One::splat(self.current.torque_per_volt[i]) * voltage[i];
                self.target[i].set_one(lane, torque);
                if self.current.bandwidth[i].is_infinite() {
                    self.motion.torque[i].set_one(lane, torque);
                }
            }
        }
        if self.standing {
            self.release();
        }
    }

    /// A torque that jumped may be more than friction can hold.
    fn release(&mut self) {
        for lane in 0..R::LANES {
            let mut one = one_of(&self.motion, lane);
            if self.single[lane].release(&one.state, &one.torque, &mut one.modes) {
                self.set_lane(lane, &one);
            }
        }
        self.standing = any_standing(&self.motion);
    }

    /// One step of the integrator; lanes in which friction changes its mode are redone singly.
    #[inline(always)]
    pub(crate) fn advance(&mut self, now: &Instant<A, R, N>, watch: &mut impl Watch<R, N>) {
        let torque = self.current.over_step(&self.motion.torque, &self.target);
        let h = R::splat(self.task.clock.step);
        let modes = &self.motion.modes;
        let state = self
            .plant
            .runge_kutta(&self.motion.state, now, &torque, modes, h, watch);
        let margins = self
            .plant
            .margins(&state, &torque.end, modes, self.standing);
        let mut least = margins[0];
        for margin in &margins[1..] {
            least = least.min(*margin);
        }
        let before = self.motion;
        self.stretches.clear();
        self.motion.state = state;
        self.motion.torque = torque.end;
        if least.any_negative() {
            self.redo(&before, least);
        }
    }

    #[inline(never)]
    fn redo(&mut self, before: &Motion<R, N>, least: R) {
        for lane in 0..R::LANES {
            if least.lane(lane) < 0.0 {
                let from = one_of(before, lane);
                let target = self.target.map(|target| target.one(lane));
                let h = self.task.clock.step;
                self.stretches.clear();
                let to = self.single[lane].advance(
                    &from,
                    &target,
                    &self.single_current,
                    h,
                    &mut self.stretches,
                );
                self.set_lane(lane, &to);
            }
        }
        self.standing = any_standing(&self.motion);
    }

    fn set_lane(&mut self, lane: usize, one: &Motion<R::One, N>) {
        let put = |all: &mut [R; N], own: &[R::One; N]| {
            for i in 0..N {
                all[i].set_one(lane, own[i]);
            }
        };
        put(&mut self.motion.state.motor_angle, &one.state.motor_angle);
        put(
            &mut self.motion.state.motor_velocity,
            &one.state.motor_velocity,
        );
        put(&mut self.motion.state.link_angle, &one.state.link_angle);
        put(
            &mut self.motion.state.link_velocity,
            &one.state.link_velocity,
        );
        put(&mut self.motion.torque, &one.torque);
        put(&mut self.motion.modes.direction, &one.modes.direction);
        put(&mut self.motion.modes.free, &one.modes.free);
    }

    fn sensors_at_rest(&self) -> Sensors<R, N> {
        let now = self.instant();
        let readings = self.readings(&now);
        let joints = &self.task.config.joints;
        let h = self.task.clock.step;
        Sensors {
            accelerometer: std::array::from_fn(|i| {
                let hz = joints[i].accelerometer_hz?;
                Some(LowPass::butterworth(hz, h, readings[0][i]))
            }),
            gyro: std::array::from_fn(|i| {
                let hz = joints[i].gyro_hz?;
                Some(LowPass::first_order(hz, h, readings[1][i]))
            }),
            readings,
        }
    }

    /// What ideal accelerometers and gyros read.
    #[inline(always)]
    fn readings(&self, now: &Instant<A, R, N>) -> [[R; N]; 2] {
        let state = &self.motion.state;
        let places = self.task.config.accelerometers();
        let acceleration = &now.acceleration.link;
        [
            A::accelerometers(&places, &now.posture, &state.link_velocity, acceleration),
            A::absolute_rates(&state.link_velocity),
        ]
    }

    #[inline(always)]
    pub(crate) fn sense(&mut self, now: &Instant<A, R, N>) {
        if self.sensors.is_none() {
            return;
        }
        let readings = self.readings(now);
        let Some(sensors) = &mut self.sensors else {
            return;
        };
        sensors.readings = readings;
        for i in 0..N {
            if let Some(filter) = &mut sensors.accelerometer[i] {
                filter.update(readings[0][i]);
                sensors.readings[0][i] = filter.output();
            }
            if let Some(filter) = &mut sensors.gyro[i] {
                filter.update(readings[1][i]);
                sensors.readings[1][i] = filter.output();
            }
        }
    }

    #[inline(never)]
    pub(crate) fn record(&mut self, step: usize, now: &Instant<A, R, N>) {
        for k in 0..self.task.record.len() {
            match self.task.record[k] {
                Quantity::Voltage => self.put(k, |group, lane, i| group.voltage[lane][i]),
                Quantity::MotorTorque => self.put_all(k, &self.motion.torque.clone()),
                Quantity::MotorAngle => self.put_all(k, &self.motion.state.motor_angle.clone()),
                Quantity::MotorVelocity => {
                    self.put_all(k, &self.motion.state.motor_velocity.clone())
                }
                Quantity::LinkAngle => self.put_all(k, &self.motion.state.link_angle.clone()),
                Quantity::LinkVelocity => self.put_all(k, &self.motion.state.link_velocity.clone()),
                Quantity::LinkAcceleration => self.put_all(k, &now.acceleration.link),
                Quantity::GearTorque => {
                    self.put_all(k, &self.plant.gear_torques(&self.motion.state))
                }
                Quantity::Encoder => self.put(k, |group, lane, i| {
                    let angle = group.motion.state.motor_angle[i].one(lane);
                    encoder_angle(angle, group.task.config.joints[i].encoder_counts)
                }),
                Quantity::Accelerometer => self.put_all(k, &self.sensed(0)),
                Quantity::Gyro => self.put_all(k, &self.sensed(1)),
                Quantity::Sliding => self.put(k, |group, lane, i| {
                    let velocity = group.motion.state.motor_velocity[i].lane(lane);
                    sign(velocity)
                }),
            }
        }
        self.check_finite(step);
    }

    fn put_all(&mut self, quantity: usize, values: &[R; N]) {
        for lane in 0..R::LANES {
            self.records[lane][quantity].push(values.map(|value| value.one(lane)));
        }
    }

    fn put(&mut self, quantity: usize, value: impl Fn(&Self, usize, usize) -> R::One) {
        for lane in 0..R::LANES {
            let row = std::array::from_fn(|i| value(self, lane, i));
            self.records[lane][quantity].push(row);
        }
    }

    fn sensed(&self, kind: usize) -> [R; N] {
        match &self.sensors {
            Some(sensors) => sensors.readings[kind],
            None => [R::splat(0.0); N],
        }
    }

    fn check_finite(&mut self, step: usize) {
        for lane in 0..R::LANES {
            let state = &self.motion.state;
            let sum = (0..N)
                .map(|i| state.motor_velocity[i].lane(lane) + state.link_velocity[i].lane(lane))
                .sum::<f64>();
            if !sum.is_finite() && self.diverged[lane].is_none() {
                let time = step as f64 * self.task.clock.step;
                self.diverged[lane] = Some(Diverged { time });
            }
        }
    }

    pub(crate) fn results(self) -> Vec<Result<RecordOf<R::One, N>, Diverged>> {
        self.records
            .into_iter()
            .zip(self.diverged)
            .map(|(record, diverged)| diverged.map_or(Ok(record), Err))
            .collect()
    }
}

impl<const N: usize> Member<'_, N> {
    /// A servo whose integral already commands the initial voltage.
    fn servo_at_rest<A: Arm<N>, S: Real>(
        &self,
        task: &Task<A, N>,
        motor_angle: &[S; N],
    ) -> ServoState<S, N> {
        let mut state = ServoState {
            integral: [S::splat(0.0); N],
            last_angle: *motor_angle,
        };
        for i in 0..N {
            let counts = task.config.joints[i].encoder_counts;
            state.last_angle[i] = encoder_angle(motor_angle[i], counts);
            if let Some(servo) = &task.servo
                && servo.active[i]
                && servo.ki[i] > 0.0
            {
                state.integral[i] = S::splat(self.initial.voltage[i] / servo.ki[i]);
            }
        }
        state
    }
}

/// The motion an experiment begins with.
fn start<A: Arm<N>, S: Real, const N: usize, const ELASTIC: bool>(
    plant: &Plant<A, S, N, ELASTIC>,
    current: &CurrentLoop<S, N>,
    initial: &Initial<N>,
    given: &impl Fn(Source, f64) -> S,
) -> Motion<S, N> {
    let each = |source: fn(usize) -> Source, values: &[f64; N]| -> [S; N] {
        std::array::from_fn(|i| given(source(i), values[i]))
    };
    let mut state = State {
        motor_angle: each(Source::MotorAngle, &initial.motor_angle),
        motor_velocity: each(Source::MotorVelocity, &initial.motor_velocity),
        link_angle: each(Source::LinkAngle, &initial.link_angle.unwrap_or([0.0; N])),
        link_velocity: each(Source::LinkVelocity, &initial.link_velocity),
    };
    if initial.link_angle.is_none() {
        let hanging = hanging(plant, &state.motor_angle);
        for i in 0..N {
            state.link_angle[i] = hanging[i] + state.link_angle[i];
        }
    }
    for i in 0..N {
        if plant.is_rigid(i) {
            state.link_angle[i] = plant.joints[i].ratio * state.motor_angle[i];
            state.link_velocity[i] = plant.joints[i].ratio * state.motor_velocity[i];
        }
    }
    let torque = std::array::from_fn(|i| S::splat(current.torque_per_volt[i] * initial.voltage[i]));
    let modes = plant.modes_at(&state, &torque);
    for i in 0..N {
        // Friction stops a standing motor however it is nudged: no derivative either.
        if modes.free[i].lane(0) == 0.0 {
            state.motor_velocity[i] = S::splat(0.0);
        }
    }
    Motion {
        state,
        torque,
        modes,
    }
}

/// Link angles at which gravity's torques and the gears' balance, for motors held where they are.
///
/// Each round takes gravity at the last angles and twists the gears by what holds it. Gravity's own
/// stiffness is some thousandth of theirs, so a round gains three digits. Once the angles have
/// settled it goes on as long again: a derivative that they carry settles as fast, but begins late.
fn hanging<A: Arm<N>, S: Real, const N: usize, const ELASTIC: bool>(
    plant: &Plant<A, S, N, ELASTIC>,
    motor_angle: &[S; N],
) -> [S; N] {
    let rigid: [S; N] = std::array::from_fn(|i| plant.joints[i].ratio * motor_angle[i]);
    let mut angle = rigid;
    let mut settled = None;
    for round in 0..400 {
        let at = A::posture(&angle);
        let gravity = A::bias(&plant.base, &at, &[S::splat(0.0); N]);
        let mut change = 0.0f64;
        for i in 0..N {
            if !plant.is_rigid(i) {
                let next = rigid[i] - plant.joints[i].spring.twist(gravity[i]);
                change = change.max((next - angle[i]).lane(0).abs());
                angle[i] = next;
            }
        }
        if change < 1e-15 && settled.is_none() {
            settled = Some(round);
        }
        if settled.is_some_and(|at| round > 2 * at) {
            break;
        }
    }
    angle
}

fn any_standing<R: Real, const N: usize>(motion: &Motion<R, N>) -> bool {
    let half = R::splat(0.5);
    motion
        .modes
        .free
        .iter()
        .any(|&free| (free - half).any_negative())
}

fn one_of<R: Real, const N: usize>(all: &Motion<R, N>, lane: usize) -> Motion<R::One, N> {
    let own = |values: &[R; N]| values.map(|value| value.one(lane));
    Motion {
        state: State {
            motor_angle: own(&all.state.motor_angle),
            motor_velocity: own(&all.state.motor_velocity),
            link_angle: own(&all.state.link_angle),
            link_velocity: own(&all.state.link_velocity),
        },
        torque: own(&all.torque),
        modes: crate::plant::Modes {
            direction: own(&all.modes.direction),
            free: own(&all.modes.free),
        },
    }
}

fn side_by_side<R: Real, const N: usize>(ones: &[Motion<R::One, N>]) -> Motion<R, N> {
    let all = |pick: fn(&Motion<R::One, N>) -> &[R::One; N]| -> [R; N] {
        std::array::from_fn(|i| gather(|lane| pick(&ones[lane])[i]))
    };
    Motion {
        state: State {
            motor_angle: all(|one| &one.state.motor_angle),
            motor_velocity: all(|one| &one.state.motor_velocity),
            link_angle: all(|one| &one.state.link_angle),
            link_velocity: all(|one| &one.state.link_velocity),
        },
        torque: all(|one| &one.torque),
        modes: crate::plant::Modes {
            direction: all(|one| &one.modes.direction),
            free: all(|one| &one.modes.free),
        },
    }
}
