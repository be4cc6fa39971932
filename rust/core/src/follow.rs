//! One plain simulation, and derivatives that follow it in columns of directions.
//!
//! Smooth steps go through [`crate::variation`]; where friction changes its mode within a step, and
//! where the servo commands, a column becomes numbers with derivatives for as long as that takes.

use std::marker::PhantomData;

use crate::arm::{Arm, Slopes};
use crate::drive::CurrentLoop;
use crate::dual::Dual;
use crate::friction::Motion;
use crate::plant::{Instant, State, Watch};
use crate::real::{Real, Work};
use crate::sensitivity::{Sensitivities, seeded};
use crate::sensors::LowPass;
use crate::simulate::{Diverged, Event, Group, Member, Quantity, Source, Task, values};
use crate::variation::{Column, Linearised, Response, Tangent, Trace};

/// One arm with elastic gears, derivatives in some directions: scalars `S`, `V::LANES` directions
/// a column, and lanes `L` for the stages of a step side by side.
pub(crate) struct Followed<'a, A, S, V, L, const N: usize> {
    pub(crate) task: &'a Task<A, N>,
    pub(crate) member: &'a Member<'a, N>,
    pub(crate) directions: &'a [Source],
    pub(crate) scalars: PhantomData<(S, V, L)>,
}

impl<A: Arm<N>, S: Real<One = S>, V: Real, L: Real, const N: usize> Work
    for Followed<'_, A, S, V, L, N>
{
    type Output = Result<Sensitivities<N>, Diverged>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut chain = Chain::<'_, A, S, V, L, N>::new(&self);
        for (step, event) in self.task.clock.instants() {
            chain.step(step, &event);
        }
        let Chain {
            nominal, tangents, ..
        } = chain;
        let mut values_of = Vec::new();
        for record in nominal.results() {
            values_of = values(&record?);
        }
        Ok(Sensitivities {
            values: values_of,
            tangents,
        })
    }
}

struct Chain<'a, A: Arm<N>, S: Real<One = S>, V: Real, L: Real, const N: usize> {
    task: &'a Task<A, N>,
    nominal: Group<'a, A, S, N, true>,
    trace: Trace<N>,
    linear: Linearised<A, L, N>,
    followers: Vec<Follower<'a, A, S, V, N>>,
    /// For each quantity samples times joints times directions.
    tangents: Vec<Vec<f64>>,
    sampled: usize,
}

impl<'a, A: Arm<N>, S: Real<One = S>, V: Real, L: Real, const N: usize> Chain<'a, A, S, V, L, N> {
    fn new(of: &Followed<'a, A, S, V, L, N>) -> Self {
        let (task, width) = (of.task, of.directions.len());
        let plain = |_, value| S::splat(value);
        Self {
            task,
            nominal: Group::new(task, std::slice::from_ref(of.member), &plain),
            trace: Trace::new(task.config.joints.map(|joint| joint.ratio)),
            linear: Linearised::new(&task.config, of.member.parameters),
            followers: (0..width)
                .step_by(V::LANES)
                .map(|first| Follower::new(task, of.member, &of.directions[first..]))
                .collect(),
            tangents: vec![vec![0.0; task.clock.samples * N * width]; task.record.len()],
            sampled: 0,
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
        self.linear.update(&self.trace, &before.modes, h);
        self.follow(event, &before, &now);
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
        let readings = self
            .task
            .record
            .contains(&Quantity::Accelerometer)
            .then(|| Readings::new(self.task, &before.state, now));
        let mut first = 0;
        for follower in &mut self.followers {
            follower.column.force(&self.linear);
            let x = follower.column.tangent;
            let torque = follower.driven.then_some(&follower.torque);
            let response = follower.column.respond(&self.linear, 0, &x, torque);
            follower.sense(readings.as_ref(), &response);
            if event.samples {
                let tangents = &mut self.tangents;
                follower.record(self.task, tangents, (self.sampled, first), &response);
            }
            if !event.last {
                if self.nominal.events.is_empty() {
                    follower.advance(&self.linear, &response, self.task.clock.step);
                } else {
                    follower.redo(before, &self.nominal, self.task.clock.step);
                }
            }
            first += V::LANES;
        }
        self.sampled += usize::from(event.samples);
    }
}

/// How the accelerometers' readings depend on the motion.
struct Readings<const N: usize> {
    slopes: Slopes<f64, N>,
    acceleration: [[f64; N]; N],
}

impl<const N: usize> Readings<N> {
    #[inline(always)]
    fn new<A: Arm<N>, S: Real>(task: &Task<A, N>, x: &State<S, N>, now: &Instant<A, S, N>) -> Self {
        let (places, posture) = (task.config.accelerometers(), &now.posture);
        let (slopes, acceleration) =
            A::accelerometer_slopes(&places, posture, &x.link_velocity, &now.acceleration.link);
        let plain = |rows: [[S; N]; N]| rows.map(|row| row.map(|number| number.lane(0)));
        Self {
            slopes: Slopes {
                angle: plain(slopes.angle),
                velocity: plain(slopes.velocity),
            },
            acceleration: plain(acceleration),
        }
    }

    #[inline(always)]
    fn tangents<A: Arm<N>, V: Real>(&self, x: &Tangent<V, N>, response: &Response<V, N>) -> [V; N] {
        let mut sum = [V::splat(0.0); N];
        for i in 0..N {
            for j in 0..N {
                if A::FELT[j] {
                    sum[i] = V::splat(self.slopes.angle[i][j]).mul_add(x.angle[j], sum[i]);
                }
                sum[i] = V::splat(self.slopes.velocity[i][j]).mul_add(x.velocity[j], sum[i]);
                sum[i] = V::splat(self.acceleration[i][j]).mul_add(response.link[j], sum[i]);
            }
        }
        sum
    }
}

/// A column of directions on its way.
struct Follower<'a, A: Arm<N>, S: Real<One = S>, V: Real, const N: usize> {
    column: Column<V, N>,
    /// The chain over numbers with derivatives, for what is not smooth.
    dual: Group<'a, A, Dual<S, V>, N, true>,
    /// Whether the torques depend on anything: they do where a servo closes the loop.
    driven: bool,
    torque: [V; N],
    target: [V; N],
    current: CurrentLoop<V, N>,
    accelerometer: [Option<LowPass<V, 2>>; N],
    gyro: [Option<LowPass<V, 1>>; N],
    readings: [[V; N]; 2],
    ratio: [f64; N],
    lanes: usize,
}

impl<'a, A: Arm<N>, S: Real<One = S>, V: Real, const N: usize> Follower<'a, A, S, V, N> {
    fn new(task: &'a Task<A, N>, member: &'a Member<'a, N>, directions: &[Source]) -> Self {
        let given = |source, value| seeded(source, value, directions);
        let dual: Group<'a, A, Dual<S, V>, N, true> =
            Group::new(task, std::slice::from_ref(member), &given);
        let zero = [V::splat(0.0); N];
        let ratio = task.config.joints.map(|joint| joint.ratio);
        let tangent = tangent_of(&dual.motion, &ratio);
        let mut own = Self {
            column: Column::new(&task.config, directions, tangent),
            driven: task.servo.is_some(),
            torque: zero,
            target: zero,
            current: task.config.current_loop(task.clock.step),
            accelerometer: [const { None }; N],
            gyro: [const { None }; N],
            readings: [zero; 2],
            ratio,
            lanes: V::LANES.min(directions.len()),
            dual,
        };
        let recorded = |quantity| task.record.contains(&quantity);
        if let Some(sensors) = &own.dual.sensors {
            let tangent = |number: &Dual<S, V>| number.tangent;
            if recorded(Quantity::Accelerometer) {
                let filters = sensors.accelerometer.each_ref();
                own.accelerometer = filters.map(|one| Some(one.as_ref()?.of_tangents(tangent)));
            }
            if recorded(Quantity::Gyro) {
                let filters = sensors.gyro.each_ref();
                own.gyro = filters.map(|one| Some(one.as_ref()?.of_tangents(tangent)));
            }
        }
        own
    }

    /// The motion with this column's derivatives.
    fn lifted(&self, nominal: &Motion<S, N>) -> Motion<Dual<S, V>, N> {
        let pair = |values: &[S; N], tangents: [V; N]| -> [Dual<S, V>; N] {
            std::array::from_fn(|i| Dual {
                value: values[i],
                tangent: tangents[i],
            })
        };
        let x = &self.column.tangent;
        let state = &nominal.state;
        Motion {
            state: State {
                motor_angle: pair(&state.motor_angle, self.motor(&x.twist, &x.angle)),
                motor_velocity: pair(&state.motor_velocity, self.motor(&x.rate, &x.velocity)),
                link_angle: pair(&state.link_angle, x.angle),
                link_velocity: pair(&state.link_velocity, x.velocity),
            },
            torque: pair(&nominal.torque, self.torque),
            modes: crate::plant::Modes {
                direction: nominal.modes.direction.map(Dual::constant),
                free: nominal.modes.free.map(Dual::constant),
            },
        }
    }

    /// A motor's derivative from the gear's and the link's.
    #[inline(always)]
    fn motor(&self, gear: &[V; N], link: &[V; N]) -> [V; N] {
        let mut motor = *gear;
        for i in 0..N {
            motor[i] = (gear[i] + link[i]) * V::splat(1.0 / self.ratio[i]);
        }
        motor
    }

    /// What the servo makes of the motion's derivatives.
    fn command(&mut self, nominal: &Motion<S, N>, step: usize, servo_reads: bool) {
        self.dual.motion = self.lifted(nominal);
        self.dual.command(step, servo_reads);
        self.target = self.dual.target.map(|number| number.tangent);
        self.torque = self.dual.motion.torque.map(|number| number.tangent);
    }

    /// A smooth step.
    #[inline(always)]
    fn advance<L: Real>(&mut self, linear: &Linearised<A, L, N>, first: &Response<V, N>, h: f64) {
        if self.driven {
            let torque = self.current.over_step(&self.torque, &self.target);
            self.column.advance(linear, first, Some(&torque), h);
            self.torque = torque.end;
        } else {
            self.column.advance(linear, first, None, h);
        }
    }

    /// A step in which friction changed its mode.
    #[inline(never)]
    fn redo(&mut self, before: &Motion<S, N>, nominal: &Group<'_, A, S, N, true>, h: f64) {
        let from = self.lifted(before);
        let target = std::array::from_fn(|i| Dual {
            value: nominal.target[i],
            tangent: self.target[i],
        });
        let (plant, current) = (&self.dual.single[0], &self.dual.single_current);

        let to = plant.follow(&from, &target, current, h, &nominal.events);
        self.column.tangent = tangent_of(&to, &self.ratio);
        if self.driven {
            self.torque = to.torque.map(|number| number.tangent);
        }
    }

    /// The sensors' readings and what their filters make of them.
    #[inline(always)]
    fn sense(&mut self, readings: Option<&Readings<N>>, response: &Response<V, N>) {
        let x = &self.column.tangent;
        if let Some(readings) = readings {
            self.readings[0] = readings.tangents::<A, V>(x, response);
        }
        self.readings[1] = A::absolute_rates(&x.velocity);
        for i in 0..N {
            if let Some(filter) = &mut self.accelerometer[i] {
                filter.update(self.readings[0][i]);
                self.readings[0][i] = filter.output();
            }
            if let Some(filter) = &mut self.gyro[i] {
                filter.update(self.readings[1][i]);
                self.readings[1][i] = filter.output();
            }
        }
    }

    /// Puts this column's lanes, from direction `first`, into a sample's place.
    #[inline(never)]
    fn record(
        &self,
        task: &Task<A, N>,
        tangents: &mut [Vec<f64>],
        (sample, first): (usize, usize),
        response: &Response<V, N>,
    ) {
        let x = &self.column.tangent;
        for (k, quantity) in task.record.iter().enumerate() {
            let row = match quantity {
                Quantity::Voltage => self.dual.voltage[0].map(|number| number.tangent),
                Quantity::MotorTorque => self.torque,
                Quantity::MotorAngle | Quantity::Encoder => self.motor(&x.twist, &x.angle),
                Quantity::MotorVelocity => self.motor(&x.rate, &x.velocity),
                Quantity::LinkAngle => x.angle,
                Quantity::LinkVelocity => x.velocity,
                Quantity::LinkAcceleration => response.link,
                Quantity::GearTorque => response.gear,
                Quantity::Accelerometer => self.readings[0],
                Quantity::Gyro => self.readings[1],
                Quantity::Sliding => continue,
            };
            let width = tangents[k].len() / (task.clock.samples * N);
            for i in 0..N {
                let own = &mut tangents[k][(sample * N + i) * width + first..];
                if self.lanes == V::LANES {
                    row[i].store(own);
                } else {
                    (0..self.lanes).for_each(|lane| own[lane] = row[i].lane(lane));
                }
            }
        }
    }
}

/// A motion's derivatives in the coordinates of the variational equations.
fn tangent_of<S: Real, V: Real, const N: usize>(
    motion: &Motion<Dual<S, V>, N>,
    ratio: &[f64; N],
) -> Tangent<V, N> {
    let x = &motion.state;
    let gear = |motor: &[Dual<S, V>; N], link: &[Dual<S, V>; N]| -> [V; N] {
        std::array::from_fn(|i| V::splat(ratio[i]).mul_add(motor[i].tangent, -link[i].tangent))
    };
    Tangent {
        twist: gear(&x.motor_angle, &x.link_angle),
        rate: gear(&x.motor_velocity, &x.link_velocity),
        angle: x.link_angle.map(|number| number.tangent),
        velocity: x.link_velocity.map(|number| number.tangent),
    }
}
