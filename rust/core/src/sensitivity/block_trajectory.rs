//! A block of directions through an experiment: its steps and its samples.
//!
//! At the start, and where a servo commands, the block is converted to dual numbers.

use crate::actuation::current_loop::{CurrentLoop, StepTorque};
use crate::arm::Arm;
use crate::arm::transmission::{link_of, outputs_of};
use crate::experiment::simulate::Simulation;
use crate::experiment::{Member, Quantity, Source, Task};
use crate::joint::gear::Gears;
use crate::plant::config::{Config, Role};
use crate::plant::friction::Motion;
use crate::plant::{Modes, State};
use crate::scalar::{Dual, Lanes, Real};
use crate::sensitivity::dual_simulation::seed_dual;
use crate::sensitivity::event::EventSensitivity;
use crate::sensitivity::sample_buffer::SampleBuffer;
use crate::sensitivity::sensing::{BlockSensors, Sensing};
use crate::sensitivity::tangent::{Response, Tangent, Workspace};
use crate::sensitivity::tangent_block::TangentBlock;
use crate::sensitivity::variational::LinearisedStep;

/// A span between events, for all blocks.
pub(crate) struct LinearisedSpan<S, const N: usize> {
    /// Motors that stick, including those held after too many events.
    pub(crate) is_stuck: [bool; N],
    /// Whether the motor of the event at the end stops instantly.
    pub(crate) stops_motor: bool,
    /// Whether the time of the event has derivatives; it has none if the modes did not fit from the
    /// beginning.
    pub(crate) has_time_derivative: bool,
    /// Remaining shares of the torques' distances to their targets.
    pub(crate) decay: StepTorque<S, N>,
    /// Length [s].
    pub(crate) duration: f64,
    /// The event at the end; `None` at the end of the step.
    pub(crate) event: Option<EventSensitivity<N>>,
    /// Derivatives of the state at the end with respect to the length [s].
    pub(crate) rates: Tangent<S, N>,
    pub(crate) torque_rates: [S; N],
}

/// A block of directions with its torques and sensors.
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
    /// The simulation over dual numbers, for operations that are not smooth.
    dual: Simulation<'a, A, Dual<S, V>, G, N, EFFECTS>,
    /// Whether the torques have derivatives: with a servo, or for directions by parameters of
    /// effects of the drive.
    pub(crate) has_torque_derivatives: bool,
    pub(crate) torque: [V; N],
    target: [V; N],
    current: CurrentLoop<V, N>,
    /// Sensors of the block, if any are recorded.
    pub(crate) block_sensors: Option<BlockSensors<V, N>>,
    /// Derivatives of the remaining length of a step, between its events.
    pub(crate) remaining: V,
    ratio: [f64; N],
    /// Half of a step [s].
    half: f64,
    /// Joint of each direction's parameter, and the index of the parameter among those of the
    /// joint.
    parameter_indices: Vec<Option<(usize, usize)>>,
    /// Index of the variant of the effects.
    variant: usize,
}

impl<'a, A: Arm<N>, S: Real, V: Lanes, G: Gears, const N: usize, const EFFECTS: bool>
    BlockTrajectory<'a, A, S, V, G, N, EFFECTS>
{
    pub(crate) fn new(
        task: &'a Task<A, N>,
        member: &'a Member<'a, N>,
        (all, first, variant): (&[Source], usize, usize),
        sensing: Option<&Sensing<V, N>>,
    ) -> Self {
        let directions = &all[first..];
        let lift = |source, value| seed_dual(source, value, directions);
        let dual: Simulation<'a, A, Dual<S, V>, G, N, EFFECTS> =
            Simulation::new(task, member, &lift);
        let zero = [V::splat(0.0); N];
        let ratio = task.config.joints.map(|joint| joint.ratio);
        let half = 0.5 * task.clock.step;
        let own = &directions[..V::LANES];
        let tangent = tangent_of(&task.config.arm, &dual.motion, &ratio, half);
        let mut trajectory = Self {
            block: TangentBlock::new(&task.config, (all, first, variant), tangent),
            has_torque_derivatives: task.servo.is_some() || has_drive_parameter(&task.config, own),
            torque: dual.motion.torque.map(|number| number.tangent),
            target: zero,
            current: task.config.current_loop(task.clock.step),
            block_sensors: None,
            remaining: V::splat(0.0),
            ratio,
            half,
            parameter_indices: joint_parameter_indices(&task.config, own),
            variant,
            dual,
        };
        if let (Some(sensing), Some(sensors)) = (sensing, &trajectory.dual.sensors) {
            let mut first = [zero; 2];
            for i in 0..N {
                let accelerometer = sensors.accelerometer[i].as_ref();
                let gyro = sensors.gyro[i].as_ref();
                first[0][i] = accelerometer.map_or(zero[i], |filter| filter.output().tangent);
                first[1][i] = gyro.map_or(zero[i], |filter| filter.output().tangent);
            }
            let imus = sensors.imu_readings.iter();
            let imus = imus.map(|row| row.map(|one| one.tangent)).collect();
            trajectory.block_sensors = Some(BlockSensors::at_rest(sensing, first, imus));
        }
        trajectory
    }

    /// The motion with the derivatives of this block.
    #[inline(always)]
    fn lifted(&self, nominal: &Motion<S, N>) -> Motion<Dual<S, V>, N> {
        lift_motion(
            nominal,
            &self.block.tangent,
            &self.torque,
            (&self.dual.plant.arm, &self.ratio, self.half),
        )
    }

    /// Applies servo and drive to the derivatives.
    pub(crate) fn command(&mut self, nominal: &Motion<S, N>, step: usize, servo_reads: bool) {
        self.dual.motion = self.lifted(nominal);
        self.dual.command(step, servo_reads);
        self.store_torques();
    }

    /// Applies a lagging drive in a step without a command.
    pub(crate) fn hold(&mut self, nominal: &Motion<S, N>) {
        if EFFECTS && self.has_torque_derivatives && self.dual.has_drive_lag {
            self.dual.motion = self.lifted(nominal);
            self.dual.hold();
            self.store_torques();
        }
    }

    fn store_torques(&mut self) {
        self.target = self.dual.target.map(|number| number.tangent);
        self.torque = self.dual.motion.torque.map(|number| number.tangent);
    }

    /// Advances by a smooth step after its first stage.
    #[inline(always)]
    pub(crate) fn advance<L: Lanes>(
        &mut self,
        linear: &LinearisedStep<A, L, G, N>,
        first: &Response<V, N>,
        workspace: &mut Workspace<V, N>,
    ) {
        if self.has_torque_derivatives {
            let torque = self.current.over_step(&self.torque, &self.target);
            self.block.advance(linear, first, Some(&torque), workspace);
            self.torque = torque.end;
        } else {
            self.block.advance(linear, first, None, workspace);
        }
    }

    /// Advances by a span between two events.
    ///
    /// With fixed length the span is a step like any other. The time of the event moves so that its
    /// margin stays zero; the remaining length of the step changes by the opposite amount.
    #[inline(always)]
    pub(crate) fn advance_span<L: Lanes>(
        &mut self,
        linear: &LinearisedStep<A, L, G, N>,
        linearised_span: &LinearisedSpan<S, N>,
        workspace: &mut Workspace<V, N>,
    ) {
        for i in 0..N {
            if linearised_span.is_stuck[i] {
                self.stop_motor(i);
            }
        }
        let torque = self.torques(&linearised_span.decay);
        let (
            TangentBlock {
                forcing, tangent, ..
            },
            mut first,
        ) = (&mut self.block, Response::zero());
        forcing.update(&linear.quads);
        forcing.respond::<_, _, _, false>(linear, 0, tangent, Some(&torque.begin), &mut first);
        let part = 0.5 * linearised_span.duration / self.half;
        self.block
            .advance_part::<A, L, G, false>(linear, &first, Some(&torque), part, workspace);
        self.torque = torque.end;
        let mut delay = self.remaining;
        if let Some(event) = &linearised_span.event {
            if linearised_span.has_time_derivative {
                let per_time = event
                    .directional_derivative(&linearised_span.rates, &linearised_span.torque_rates)
                    .lane(0);
                let derivative = event.directional_derivative(&self.block.tangent, &self.torque);
                delay = (derivative
                    + event.by_parameters::<V>(self.variant, &self.parameter_indices))
                    * (-1.0 / per_time);
            }
            self.remaining = self.remaining - delay;
        }
        self.block.tangent.add(&linearised_span.rates, delay);
        for i in 0..N {
            let rate = V::splat(linearised_span.torque_rates[i].lane(0));
            self.torque[i] = rate.mul_add(delay, self.torque[i]);
        }
        if let Some(event) = &linearised_span.event
            && linearised_span.stops_motor
        {
            self.stop_motor(event.joint);
        }
    }

    /// Sets the velocity derivatives of a resting motor to zero.
    #[inline(always)]
    fn stop_motor(&mut self, joint: usize) {
        self.block.tangent.motor[joint] = V::splat(0.0);
    }

    /// Derivatives of the torques over a span. `decay` is the remaining share of each distance to
    /// the target. Open-loop torques have derivatives between events too, because the times of
    /// events have derivatives.
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
        match &self.block_sensors {
            Some(block_sensors) => block_sensors.readings[kind],
            None => [V::splat(0.0); N],
        }
    }

    #[inline(always)]
    fn link_readings(&self, sensor: usize) -> [V; N] {
        match &self.block_sensors {
            Some(block_sensors) => block_sensors.imus.readings[sensor],
            None => [V::splat(0.0); N],
        }
    }

    /// Stores the lanes of this block in a sample, for each quantity and joint.
    #[inline(always)]
    pub(crate) fn record(
        &self,
        quantities: &[Quantity],
        buffer: &mut SampleBuffer,
        first: usize,
        response: &Response<V, N>,
    ) {
        let x = &self.block.tangent;
        let per_second = 1.0 / self.half;
        for (k, quantity) in quantities.iter().enumerate() {
            let row = match quantity {
                Quantity::Voltage => self.dual.voltage.map(|number| number.tangent),
                Quantity::MotorTorque => self.torque,
                Quantity::MotorAngle | Quantity::Encoder => {
                    x.motor_angles(&self.dual.plant.arm, &self.ratio)
                }
                Quantity::MotorVelocity => x.motor_velocities(&self.ratio, self.half),
                Quantity::LinkAngle => x.angle,
                Quantity::LinkVelocity => x.link_velocities(self.half),
                Quantity::LinkAcceleration => {
                    times_number(&times_number(&response.link, per_second), per_second)
                }
                Quantity::GearTorque => response.gear,
                Quantity::Torsion => x.torsion,
                Quantity::Accelerometer => self.reading(0),
                Quantity::Gyro => self.reading(1),
                Quantity::LinkSensor(k) => self.link_readings(*k),
                Quantity::Sliding => continue,
            };
            for i in 0..self.dual.plant.arm.joints() {
                row[i].store(&mut buffer.entry(k, i)[first..]);
            }
        }
    }
}

/// Whether a direction is a parameter of an effect of the drive.
fn has_drive_parameter<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    directions: &[Source],
) -> bool {
    let roles = config.roles();
    directions.iter().any(|&direction| {
        let Source::Parameter(k) = direction else {
            return false;
        };
        let (Role::Effect(position), joint) = roles[k] else {
            return false;
        };
        config.joints[joint].effects.parameters()[position].of_drive
    })
}

/// Joint of each direction's parameter, and the index of the parameter among those of the joint.
fn joint_parameter_indices<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    directions: &[Source],
) -> Vec<Option<(usize, usize)>> {
    let names = config.parameter_names();
    let position = |source: &Source| {
        let &Source::Parameter(k) = source else {
            return None;
        };
        let joint_names = names.get(config.arm.names().len()..k)?;
        let joint = names[k].1?;
        let before = joint_names.iter().filter(|name| name.1 == Some(joint));
        Some((joint - 1, before.count()))
    };
    directions.iter().map(position).collect()
}

/// Converts outputs of the gears to motor-side values.
#[inline(always)]
fn to_motor_side<V: Real, const N: usize>(ratio: &[f64; N], link_side: &[V; N]) -> [V; N] {
    let mut motor = *link_side;
    for i in 0..N {
        motor[i] = link_side[i] * (1.0 / ratio[i]);
    }
    motor
}

/// No closure, each of which would be a call.
#[inline(always)]
fn times_number<V: Real, const N: usize>(all: &[V; N], factor: f64) -> [V; N] {
    let mut products = *all;
    for i in 0..N {
        products[i] = all[i] * factor;
    }
    products
}

impl<V: Real, const N: usize> Tangent<V, N> {
    /// Derivatives of the motor angles [rad].
    #[inline(always)]
    fn motor_angles<A: Arm<N>>(&self, arm: &A, ratio: &[f64; N]) -> [V; N] {
        let mut link_side = self.torsion;
        for i in 0..N {
            link_side[i] = self.torsion[i] + self.angle[i];
        }
        to_motor_side(ratio, &outputs_of(arm, &link_side))
    }

    /// Derivatives of the motor velocities [rad/s]; `half` [s] is half a step.
    #[inline(always)]
    fn motor_velocities(&self, ratio: &[f64; N], half: f64) -> [V; N] {
        times_number(&to_motor_side(ratio, &self.motor), 1.0 / half)
    }

    /// Derivatives of the link velocities [rad/s].
    #[inline(always)]
    fn link_velocities(&self, half: f64) -> [V; N] {
        times_number(&self.link, 1.0 / half)
    }
}

/// A motion with derivatives, over dual numbers.
#[inline(always)]
fn lift_motion<A: Arm<N>, S: Real, V: Real, const N: usize>(
    nominal: &Motion<S, N>,
    x: &Tangent<V, N>,
    torque: &[V; N],
    (arm, ratio, half): (&A, &[f64; N], f64),
) -> Motion<Dual<S, V>, N> {
    let state = &nominal.state;
    Motion {
        state: State {
            motor_angle: pair(&state.motor_angle, &x.motor_angles(arm, ratio)),
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

/// Derivatives of a motion in the coordinates of the variational equations.
fn tangent_of<A: Arm<N>, S: Real, V: Real, const N: usize>(
    arm: &A,
    motion: &Motion<Dual<S, V>, N>,
    ratio: &[f64; N],
    half: f64,
) -> Tangent<V, N> {
    let x = &motion.state;
    let angle = x.link_angle.map(|number| number.tangent);
    let ratios = ratio.map(V::splat);
    let motor_angle = x.motor_angle.map(|number| number.tangent);
    Tangent {
        torsion: std::array::from_fn(|i| link_of(arm, i, &ratios, &motor_angle, -angle[i])),
        angle,
        motor: std::array::from_fn(|i| ratios[i] * x.motor_velocity[i].tangent * half),
        link: x.link_velocity.map(|number| number.tangent * half),
    }
}
