//! Experiments run: voltages and references in, what motors, links and sensors did out.

use std::marker::PhantomData;

use crate::actuation::Controller;
use crate::actuation::controller::ServoMemory;
use crate::actuation::current_loop::CurrentLoop;
use crate::arm::Arm;
use crate::experiment::start::start;
use crate::experiment::{Diverged, Event, Member, Quantity, RecordOf, Source, Task};
use crate::joint::Joint;
use crate::joint::gear::Gears;
use crate::plant::friction::{Motion, Stretch, sign};
use crate::plant::{Instant, Plant, State, Watch};
use crate::scalar::{Real, Work, gather};
use crate::sensors::encoder::encoder_angle;
use crate::sensors::imu::{self, MOUNTED, Mounted};
use crate::sensors::low_pass::LowPass;

/// Arms to be run side by side, a multiple of `R::LANES`. Steps of single lanes in which friction
/// changes its mode are redone on `R::One`.
///
/// Groups of `R::LANES` take turns at every step: while one waits for its own last result, the
/// processor is already at the next one's operations.
pub struct SideBySide<'a, A, R, F, G: Gears, const N: usize, const EFFECTS: bool = false> {
    task: &'a Task<A, N>,
    members: &'a [Member<'a, N>],
    given: F,
    scalar: PhantomData<(R, G)>,
}

impl<'a, A: Arm<N>, R: Real, F, G: Gears, const N: usize, const EFFECTS: bool>
    SideBySide<'a, A, R, F, G, N, EFFECTS>
where
    F: Fn(Source, f64) -> R::One,
{
    /// A multiple of `R::LANES` members, and how a number that a motion depends on is to be had
    /// from its value.
    pub fn new(task: &'a Task<A, N>, members: &'a [Member<'a, N>], given: F) -> Self {
        Self {
            task,
            members,
            given,
            scalar: PhantomData,
        }
    }
}

impl<A: Arm<N>, R: Real, F, G: Gears, const N: usize, const EFFECTS: bool> Work
    for SideBySide<'_, A, R, F, G, N, EFFECTS>
where
    F: Fn(Source, f64) -> R::One,
{
    type Output = Vec<Result<RecordOf<R::One, N>, Diverged>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut groups: Vec<Group<'_, A, R, G, N, EFFECTS>> = self
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

/// Arms that run side by side.
pub(crate) struct Group<
    'a,
    A: Arm<N>,
    R: Real,
    G: Gears,
    const N: usize,
    const EFFECTS: bool = false,
> {
    task: &'a Task<A, N>,
    members: &'a [Member<'a, N>],
    pub(crate) plant: Plant<A, R, G, N, EFFECTS>,
    current: CurrentLoop<R, N>,
    pub(crate) single: Vec<Plant<A, R::One, G, N, EFFECTS>>,
    pub(crate) single_current: CurrentLoop<R::One, N>,
    pub(crate) motion: Motion<R, N>,
    standing: bool,
    pub(crate) target: [R; N],
    pub(crate) voltage: Vec<[R::One; N]>,
    /// What each lane's drives make of their voltages [V], and what they remember of earlier ones.
    driven: Vec<[R::One; N]>,
    remembered: Vec<[R::One; N]>,
    /// Whether any drive lags.
    pub(crate) lags: bool,
    /// What each lane's controller remembers; nothing where there is none.
    servo: Vec<ServoMemory<R::One, N>>,
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
    /// What an IMU's sensors read combinations of, where any of it is recorded.
    pub(crate) mounted: Option<Mounted<R, N>>,
    readings: [[R; N]; 2],
}

impl<'a, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>
    Group<'a, A, R, G, N, EFFECTS>
{
    pub(crate) fn new(
        task: &'a Task<A, N>,
        members: &'a [Member<'a, N>],
        given: &impl Fn(Source, f64) -> R::One,
    ) -> Self {
        assert_eq!(members.len(), R::LANES);
        let step = task.clock.step;
        let parameter = |lane: usize, k| given(Source::Parameter(k), members[lane].parameters[k]);
        let single: Vec<Plant<A, R::One, G, N, EFFECTS>> = (0..R::LANES)
            .map(|lane| task.config.plant_of(|k| parameter(lane, k)))
            .collect();
        let single_current = task.config.current_loop(step);
        let starts: Vec<Motion<R::One, N>> = members
            .iter()
            .zip(&single)
            .map(|(member, plant)| start(plant, &single_current, &member.initial, given))
            .collect();
        let motion = side_by_side(&starts);
        let driven = |(member, plant): (&Member<'a, N>, &Plant<A, R::One, G, N, EFFECTS>)| {
            std::array::from_fn(|i| {
                let before = R::One::splat(member.initial.voltage[i]);
                plant.joints[i].driven::<EFFECTS>(before)
            })
        };
        let driven: Vec<[R::One; N]> = members.iter().zip(&single).map(driven).collect();
        let lag = |joint: &Joint<R::One, G>| joint.effects.drive_lag.is_some();
        let lags = EFFECTS && single.iter().any(|plant| plant.joints.iter().any(lag));
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
            remembered: driven.clone(),
            driven,
            lags,
            servo: Vec::new(),
            sensors: None,
            stretches: Vec::new(),
            records: vec![
                vec![Vec::with_capacity(task.clock.samples); task.record.len()];
                R::LANES
            ],
            diverged: vec![None; R::LANES],
        };
        if let Some(servo) = &task.servo {
            let at_rest = |(lane, member): (usize, &Member<'a, N>)| {
                servo.at_rest(&member.initial.voltage, &group.encoder(lane))
            };
            group.servo = members.iter().enumerate().map(at_rest).collect();
        }
        let senses = |quantity| task.record.contains(&quantity);
        let mounted = task.record.iter().any(|one| one.mounted().is_some());
        if senses(Quantity::Accelerometer) || senses(Quantity::Gyro) || mounted {
            group.sensors = Some(group.sensors_at_rest());
        }
        group
    }

    /// What happens at one instant, and the step that follows it.
    #[inline(always)]
    fn step(&mut self, step: usize, event: &Event) {
        if event.commands {
            self.command(step, event.servo_reads);
        } else if EFFECTS && self.lags {
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
    pub(crate) fn instant(&self) -> Instant<A, R, N> {
        let motion = &self.motion;
        self.plant
            .instant(&motion.state, &motion.torque, &motion.modes)
    }

    /// What one lane's encoders read [rad].
    fn encoder(&self, lane: usize) -> [R::One; N] {
        std::array::from_fn(|i| {
            let angle = self.motion.state.motor_angle[i].one(lane);
            encoder_angle(angle, self.task.config.joints[i].encoder_counts)
        })
    }

    /// Takes in the voltages of this instant: the tick's feed-forward, and the servo where it reads.
    pub(crate) fn command(&mut self, step: usize, servo_reads: bool) {
        let tick = step / self.task.clock.steps_per_tick;
        for lane in 0..R::LANES {
            let member = &self.members[lane];
            let feed_forward = &member.feed_forward[tick];
            let encoder = self.encoder(lane);
            let voltage = &mut self.voltage[lane];
            match &self.task.servo {
                Some(servo) if servo_reads => {
                    let reference = &member.reference[tick];
                    *voltage =
                        servo.command(&mut self.servo[lane], reference, &encoder, feed_forward);
                }
                Some(servo) => {
                    for i in 0..N {
                        if !servo.drives(i) {
                            voltage[i] = R::One::splat(feed_forward[i]);
                        }
                    }
                }
                None => *voltage = feed_forward.map(R::One::splat),
            }
            for i in 0..N {
                let joint = &self.single[lane].joints[i];
                self.driven[lane][i] = joint.driven::<EFFECTS>(voltage[i]);
            }
        }
        self.hold();
    }

    /// Brings to the motors what acts over the next step of what the drives make of their voltages.
    #[inline(always)]
    pub(crate) fn hold(&mut self) {
        for lane in 0..R::LANES {
            for i in 0..N {
                let (driven, memory) = (self.driven[lane][i], &mut self.remembered[lane][i]);
                let joint = &self.single[lane].joints[i];
                let driven = joint.held::<EFFECTS>(driven, memory, self.task.clock.step);
                let torque = R::One::splat(self.current.torque_per_volt[i]) * driven;
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
        put(&mut self.motion.state.hysteresis, &one.state.hysteresis);
        put(&mut self.motion.state.part_angle, &one.state.part_angle);
        put(
            &mut self.motion.state.part_velocity,
            &one.state.part_velocity,
        );
        put(&mut self.motion.state.base_torque, &one.state.base_torque);
        put(
            &mut self.motion.state.base_torque_rate,
            &one.state.base_torque_rate,
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
            mounted: self
                .task
                .record
                .iter()
                .any(|one| one.mounted().is_some())
                .then(|| Mounted::at_rest(&self.task.config, h, self.signals(&now))),
            readings,
        }
    }

    /// What ideal accelerometers and gyros read.
    #[inline(always)]
    fn readings(&self, now: &Instant<A, R, N>) -> [[R; N]; 2] {
        let state = &self.motion.state;
        let (arm, velocity) = (&self.plant.arm, &state.link_velocity);
        let acceleration = &now.acceleration.link;
        [
            arm.accelerometers(&now.posture, velocity, acceleration),
            arm.absolute_rates(&now.posture, velocity),
        ]
    }

    /// What an IMU's sensors read combinations of, before any low-pass.
    #[inline(always)]
    fn signals(&self, now: &Instant<A, R, N>) -> [[R; N]; MOUNTED] {
        let velocity = &self.motion.state.link_velocity;
        let acceleration = &now.acceleration.link;
        imu::ideal(&self.plant.arm, &now.posture, velocity, acceleration)
    }

    #[inline(always)]
    pub(crate) fn sense(&mut self, now: &Instant<A, R, N>) {
        let Some(sensors) = &self.sensors else {
            return;
        };
        let signals = sensors.mounted.is_some().then(|| self.signals(now));
        let readings = self.readings(now);
        let Some(sensors) = &mut self.sensors else {
            return;
        };
        if let (Some(mounted), Some(signals)) = (&mut sensors.mounted, signals) {
            mounted.update(signals);
        }
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
        R::scope(Recording(self, step, now));
    }

    #[inline(always)]
    fn record_all(&mut self, step: usize, now: &Instant<A, R, N>) {
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
                Quantity::SpecificForceX
                | Quantity::SpecificForceY
                | Quantity::AngularAcceleration
                | Quantity::SquaredRate
                | Quantity::AngularRate => self.put_all(k, &self.mounted(self.task.record[k])),
                Quantity::Sliding => self.put(k, |group, lane, i| {
                    let velocity = group.motion.state.motor_velocity[i].lane(lane);
                    sign(velocity)
                }),
            }
        }
        self.check_finite(step);
    }

    #[inline(always)]
    fn put_all(&mut self, quantity: usize, values: &[R; N]) {
        for lane in 0..R::LANES {
            self.records[lane][quantity].push(values.map(|value| value.one(lane)));
        }
    }

    #[inline(always)]
    fn put(&mut self, quantity: usize, value: impl Fn(&Self, usize, usize) -> R::One) {
        for lane in 0..R::LANES {
            let row = std::array::from_fn(|i| value(self, lane, i));
            self.records[lane][quantity].push(row);
        }
    }

    #[inline(always)]
    fn sensed(&self, kind: usize) -> [R; N] {
        match &self.sensors {
            Some(sensors) => sensors.readings[kind],
            None => [R::splat(0.0); N],
        }
    }

    #[inline(always)]
    fn mounted(&self, quantity: Quantity) -> [R; N] {
        let sensors = self.sensors.as_ref();
        match (
            quantity.mounted(),
            sensors.and_then(|all| all.mounted.as_ref()),
        ) {
            (Some(place), Some(mounted)) => mounted.readings[place],
            _ => [R::splat(0.0); N],
        }
    }

    #[inline(always)]
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

/// [`Group::record`]: what the compiler takes out of its loop, asked for or not, must not be calls.
struct Recording<'g, 'a, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    &'g mut Group<'a, A, R, G, N, EFFECTS>,
    usize,
    &'g Instant<A, R, N>,
);

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Work
    for Recording<'_, '_, A, R, G, N, EFFECTS>
{
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.record_all(self.1, self.2);
    }
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
            hysteresis: own(&all.state.hysteresis),
            part_angle: own(&all.state.part_angle),
            part_velocity: own(&all.state.part_velocity),
            base_torque: own(&all.state.base_torque),
            base_torque_rate: own(&all.state.base_torque_rate),
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
            hysteresis: all(|one| &one.state.hysteresis),
            part_angle: all(|one| &one.state.part_angle),
            part_velocity: all(|one| &one.state.part_velocity),
            base_torque: all(|one| &one.state.base_torque),
            base_torque_rate: all(|one| &one.state.base_torque_rate),
        },
        torque: all(|one| &one.torque),
        modes: crate::plant::Modes {
            direction: all(|one| &one.modes.direction),
            free: all(|one| &one.modes.free),
        },
    }
}
