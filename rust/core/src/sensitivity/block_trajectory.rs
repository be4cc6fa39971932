//! A block of directions on its way through an experiment: its steps and its samples.
//!
//! At the beginning, and where a servo commands, a block becomes numbers with derivatives for that
//! moment.

use crate::actuation::current_loop::{CurrentLoop, StepTorque};
use crate::arm::Arm;
use crate::experiment::simulate::Simulation;
use crate::experiment::{Member, Quantity, Source, Task};
use crate::joint::gear::Gears;
use crate::plant::config::{Config, Role};
use crate::plant::friction::Motion;
use crate::plant::{Modes, State};
use crate::scalar::{Dual, Lanes, Real};
use crate::sensitivity::dual_simulation::seeded;
use crate::sensitivity::event::EventSensitivity;
use crate::sensitivity::imu::MountedSensed;
use crate::sensitivity::sample_buffer::SampleBuffer;
use crate::sensitivity::sensing::{Sensed, Sensing};
use crate::sensitivity::tangent::{Response, Tangent};
use crate::sensitivity::tangent_block::TangentBlock;
use crate::sensitivity::variational::Linearised;

/// A stretch between events, as every block goes through it.
pub(crate) struct Through<S, const N: usize> {
    /// Motors that stand, as those do that are held after too many events.
    pub(crate) rests: [bool; N],
    /// Whether the motor whose event ends it comes to rest at once.
    pub(crate) stops: bool,
    /// Whether the event's instant depends on anything: not where the modes never fitted.
    pub(crate) moves: bool,
    /// What is left of the torques' distances to their targets.
    pub(crate) decay: StepTorque<S, N>,
    /// How long it takes [s].
    pub(crate) duration: f64,
    /// The event that ends it, if it is one.
    pub(crate) event: Option<EventSensitivity>,
    /// How fast its end moves as it gets longer, and the torques there.
    pub(crate) rates: Tangent<S, N>,
    pub(crate) torque_rates: [S; N],
}

/// A block of directions on its way.
pub(crate) struct BlockTrajectory<
    'a,
    A: Arm<N>,
    S: Real,
    V: Lanes,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
> {
    pub(crate) block: TangentBlock<V, N>,
    /// The chain over numbers with derivatives, for what is not smooth.
    dual: Simulation<'a, A, Dual<S, V>, G, N, EFFECTS>,
    /// Whether the torques depend on anything: they do where a servo closes the loop, and where a
    /// direction is by the size of what the drive does to a voltage.
    pub(crate) driven: bool,
    pub(crate) torque: [V; N],
    target: [V; N],
    current: CurrentLoop<V, N>,
    /// Its sensors, if any are recorded.
    pub(crate) sensed: Option<Sensed<V, N>>,
    /// How what is left of a step moves, between its events.
    pub(crate) left: V,
    ratio: [f64; N],
    /// Half of a step [s].
    half: f64,
    /// The joint whose parameter a direction is by, and the parameter's place among its own.
    own: Vec<Option<(usize, usize)>>,
}

impl<'a, A: Arm<N>, S: Real, V: Lanes, G: Gears, const N: usize, const EFFECTS: bool>
    BlockTrajectory<'a, A, S, V, G, N, EFFECTS>
{
    pub(crate) fn new(
        task: &'a Task<A, N>,
        member: &'a Member<'a, N>,
        directions: &[Source],
        sensing: Option<&Sensing<V, N>>,
    ) -> Self {
        let given = |source, value| seeded(source, value, directions);
        let dual: Simulation<'a, A, Dual<S, V>, G, N, EFFECTS> =
            Simulation::new(task, member, &given);
        let zero = [V::splat(0.0); N];
        let ratio = task.config.joints.map(|joint| joint.ratio);
        let half = 0.5 * task.clock.step;
        let most = directions.len().min(V::LANES);
        let tangent = tangent_of(&dual.motion, &ratio, half);
        let mut own = Self {
            block: TangentBlock::new(&task.config, directions, tangent),
            driven: task.servo.is_some() || drives(&task.config, &directions[..most]),
            torque: dual.motion.torque.map(|number| number.tangent),
            target: zero,
            current: task.config.current_loop(task.clock.step),
            sensed: None,
            left: V::splat(0.0),
            ratio,
            half,
            own: own_parameters(&task.config, &directions[..most]),
            dual,
        };
        if let (Some(sensing), Some(sensors)) = (sensing, &own.dual.sensors) {
            let mut first = [zero; 2];
            for i in 0..N {
                let accelerometer = sensors.accelerometer[i].as_ref();
                let gyro = sensors.gyro[i].as_ref();
                first[0][i] = accelerometer.map_or(zero[i], |filter| filter.output().tangent);
                first[1][i] = gyro.map_or(zero[i], |filter| filter.output().tangent);
            }
            let mut sensed = Sensed::at_rest(sensing, first);
            if let (Some(all), Some(mounted)) = (&sensing.mounted, &sensors.mounted) {
                let first = mounted.readings.map(|row| row.map(|one| one.tangent));
                sensed.mounted = Some(Box::new(MountedSensed::at_rest(all, first)));
            }
            own.sensed = Some(sensed);
        }
        own
    }

    /// The motion with this block's derivatives.
    #[inline(always)]
    fn lifted(&self, nominal: &Motion<S, N>) -> Motion<Dual<S, V>, N> {
        lifted(
            nominal,
            &self.block.tangent,
            &self.torque,
            (&self.ratio, self.half),
        )
    }

    /// What the servo and the drive make of the motion's derivatives.
    pub(crate) fn command(&mut self, nominal: &Motion<S, N>, step: usize, servo_reads: bool) {
        self.dual.motion = self.lifted(nominal);
        self.dual.command(step, servo_reads);
        self.take_torques();
    }

    /// What a drive that lags makes of them in the step after a command.
    ///
    /// A lag of no size has caught up by then: in later steps nothing changes.
    pub(crate) fn hold(&mut self, nominal: &Motion<S, N>) {
        if EFFECTS && self.driven && self.dual.lags {
            self.dual.motion = self.lifted(nominal);
            self.dual.hold();
            self.take_torques();
        }
    }

    fn take_torques(&mut self) {
        self.target = self.dual.target.map(|number| number.tangent);
        self.torque = self.dual.motion.torque.map(|number| number.tangent);
    }

    /// A smooth step.
    #[inline(always)]
    pub(crate) fn advance<L: Lanes>(
        &mut self,
        linear: &Linearised<A, L, G, N>,
        first: &Response<V, N>,
    ) {
        if self.driven {
            let torque = self.current.over_step(&self.torque, &self.target);
            self.block.advance(linear, first, Some(&torque));
            self.torque = torque.end;
        } else {
            self.block.advance(linear, first, None);
        }
    }

    /// A stretch between two events.
    ///
    /// With its length fixed it is a step like any other. The event's instant moves by what holds
    /// its margin at zero; what was left of the step, by the opposite.
    #[inline(always)]
    pub(crate) fn pass<L: Lanes>(
        &mut self,
        linear: &Linearised<A, L, G, N>,
        through: &Through<S, N>,
    ) {
        for i in 0..N {
            if through.rests[i] {
                self.rest(i);
            }
        }
        let torque = self.torques(&through.decay);
        let x = self.block.tangent;
        let first = self.block.respond(linear, 0, &x, Some(&torque.begin));
        let part = 0.5 * through.duration / self.half;
        self.block
            .advance_part::<A, L, G, false>(linear, &first, Some(&torque), part);
        self.torque = torque.end;
        let mut later = self.left;
        if let Some(event) = &through.event {
            if through.moves {
                let per_time = event.along(&through.rates, &through.torque_rates).lane(0);
                let along = event.along(&self.block.tangent, &self.torque);
                later = (along + event.by_parameters(&self.own)) * V::splat(-1.0 / per_time);
            }
            self.left = self.left - later;
        }
        self.block.tangent.add(&through.rates, later);
        for i in 0..N {
            let rate = V::splat(through.torque_rates[i].lane(0));
            self.torque[i] = rate.mul_add(later, self.torque[i]);
        }
        if let Some(event) = &through.event
            && through.stops
        {
            self.rest(event.joint);
        }
    }

    /// The motor does not move.
    #[inline(always)]
    fn rest(&mut self, joint: usize) {
        self.block.tangent.motor[joint] = V::splat(0.0);
    }

    /// The torques' derivatives over a stretch, of which `decay` of each distance to the target is
    /// left. Even open-loop torques have some between events: an event's instant moves along them.
    #[inline(always)]
    fn torques(&self, decay: &StepTorque<S, N>) -> StepTorque<V, N> {
        let mut torque = StepTorque {
            begin: self.torque,
            middle: self.target,
            end: self.target,
        };
        for i in 0..N {
            let distance = self.torque[i] - self.target[i];
            torque.middle[i] = V::splat(decay.middle[i].lane(0)).mul_add(distance, self.target[i]);
            torque.end[i] = V::splat(decay.end[i].lane(0)).mul_add(distance, self.target[i]);
        }
        torque
    }

    #[inline(always)]
    fn reading(&self, kind: usize) -> [V; N] {
        match &self.sensed {
            Some(sensed) => sensed.readings[kind],
            None => [V::splat(0.0); N],
        }
    }

    #[inline(always)]
    fn mounted(&self, quantity: Quantity) -> [V; N] {
        let sensed = self.sensed.as_ref();
        match (
            quantity.mounted(),
            sensed.and_then(|all| all.mounted.as_ref()),
        ) {
            (Some(place), Some(mounted)) => mounted.readings[place],
            _ => [V::splat(0.0); N],
        }
    }

    /// Puts this block's lanes into a sample: for each quantity and joint, all blocks' numbers.
    #[inline(always)]
    pub(crate) fn record(
        &self,
        quantities: &[Quantity],
        buffer: &mut SampleBuffer<N>,
        first: usize,
        response: &Response<V, N>,
    ) {
        let x = &self.block.tangent;
        let per_second = V::splat(1.0 / self.half);
        for (k, quantity) in quantities.iter().enumerate() {
            let row = match quantity {
                Quantity::Voltage => self.dual.voltage.map(|number| number.tangent),
                Quantity::MotorTorque => self.torque,
                Quantity::MotorAngle | Quantity::Encoder => x.motor_angles(&self.ratio),
                Quantity::MotorVelocity => x.motor_velocities(&self.ratio, self.half),
                Quantity::LinkAngle => x.angle,
                Quantity::LinkVelocity => x.link_velocities(self.half),
                Quantity::LinkAcceleration => {
                    response.link.map(|one| per_second * per_second * one)
                }
                Quantity::GearTorque => response.gear,
                Quantity::Accelerometer => self.reading(0),
                Quantity::Gyro => self.reading(1),
                Quantity::SpecificForceX
                | Quantity::SpecificForceY
                | Quantity::AngularAcceleration
                | Quantity::SquaredRate
                | Quantity::AngularRate => self.mounted(*quantity),
                Quantity::Sliding => continue,
            };
            for i in 0..N {
                row[i].store(&mut buffer.place(k, i)[first..]);
            }
        }
    }
}

/// Whether a direction is by the size of an effect that changes what the drive makes of a voltage.
fn drives<A: Arm<N>, const N: usize>(config: &Config<A, N>, directions: &[Source]) -> bool {
    let roles = config.roles();
    directions.iter().any(|&direction| {
        let Source::Parameter(k) = direction else {
            return false;
        };
        let (Role::Effect(place), joint) = roles[k] else {
            return false;
        };
        let size = config.joints[joint].effects.parameters()[place].1;
        size.is_some_and(|size| size.enters.drive)
    })
}

/// The joint of each direction's parameter, and its place among that joint's.
fn own_parameters<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    directions: &[Source],
) -> Vec<Option<(usize, usize)>> {
    let names = config.parameter_names();
    let place = |source: &Source| {
        let &Source::Parameter(k) = source else {
            return None;
        };
        let own = names.get(config.arm.names().len()..k)?;
        let joint = names[k].1?;
        let before = own.iter().filter(|name| name.1 == Some(joint));
        Some((joint - 1, before.count()))
    };
    directions.iter().map(place).collect()
}

/// At the motors what is given at the links' side of their gears.
#[inline(always)]
fn over<V: Real, const N: usize>(ratio: &[f64; N], link_side: &[V; N]) -> [V; N] {
    let mut motor = *link_side;
    for i in 0..N {
        motor[i] = link_side[i] * V::splat(1.0 / ratio[i]);
    }
    motor
}

impl<V: Real, const N: usize> Tangent<V, N> {
    /// Of the motors' angles [rad].
    #[inline(always)]
    fn motor_angles(&self, ratio: &[f64; N]) -> [V; N] {
        let mut link_side = self.twist;
        for i in 0..N {
            link_side[i] = self.twist[i] + self.angle[i];
        }
        over(ratio, &link_side)
    }

    /// Of the motors' velocities [rad/s], `half` [s] being half a step.
    #[inline(always)]
    fn motor_velocities(&self, ratio: &[f64; N], half: f64) -> [V; N] {
        over(ratio, &self.motor).map(|one| V::splat(1.0 / half) * one)
    }

    /// Of the links' velocities [rad/s].
    #[inline(always)]
    fn link_velocities(&self, half: f64) -> [V; N] {
        self.link.map(|one| V::splat(1.0 / half) * one)
    }
}

/// A motion with derivatives.
#[inline(always)]
fn lifted<S: Real, V: Real, const N: usize>(
    nominal: &Motion<S, N>,
    x: &Tangent<V, N>,
    torque: &[V; N],
    (ratio, half): (&[f64; N], f64),
) -> Motion<Dual<S, V>, N> {
    let state = &nominal.state;
    Motion {
        state: State {
            motor_angle: pair(&state.motor_angle, &x.motor_angles(ratio)),
            motor_velocity: pair(&state.motor_velocity, &x.motor_velocities(ratio, half)),
            link_angle: pair(&state.link_angle, &x.angle),
            link_velocity: pair(&state.link_velocity, &x.link_velocities(half)),
            hysteresis: state.hysteresis.map(Dual::constant),
            part_angle: state.part_angle.map(Dual::constant),
            part_velocity: state.part_velocity.map(Dual::constant),
            base_torque: state.base_torque.map(Dual::constant),
            base_torque_rate: state.base_torque_rate.map(Dual::constant),
        },
        torque: pair(&nominal.torque, torque),
        modes: Modes {
            direction: nominal.modes.direction.map(Dual::constant),
            free: nominal.modes.free.map(Dual::constant),
        },
    }
}

#[inline(always)]
fn pair<S: Real, V: Real, const N: usize>(values: &[S; N], tangents: &[V; N]) -> [Dual<S, V>; N] {
    std::array::from_fn(|i| Dual {
        value: values[i],
        tangent: tangents[i],
    })
}

/// A motion's derivatives in the coordinates of the variational equations.
fn tangent_of<S: Real, V: Real, const N: usize>(
    motion: &Motion<Dual<S, V>, N>,
    ratio: &[f64; N],
    half: f64,
) -> Tangent<V, N> {
    let x = &motion.state;
    let angle = x.link_angle.map(|number| number.tangent);
    let at_links = |i: usize, motor: &[Dual<S, V>; N]| V::splat(ratio[i]) * motor[i].tangent;
    Tangent {
        twist: std::array::from_fn(|i| at_links(i, &x.motor_angle) - angle[i]),
        angle,
        motor: std::array::from_fn(|i| V::splat(half) * at_links(i, &x.motor_velocity)),
        link: x
            .link_velocity
            .map(|number| V::splat(half) * number.tangent),
    }
}
