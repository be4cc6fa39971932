//! Arms and runs shared by the tests.

use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use strainwave_arms::WithPrograms;
use strainwave_core::actuation::{JointLaw, LawState, LinearServo, MAX_LAW_STATES, Servo};
use strainwave_core::arm::{
    Arm, ChainJoint, JointType, MAX_CHAIN_JOINTS, OneLink, SerialChain, TwoLink,
};
use strainwave_core::experiment::{
    Clock, Diverged, Initial, Member, Quantity, Record, Source, Task,
};
use strainwave_core::joint::effects::{self, EffectDeclaration, EffectKinds};
use strainwave_core::joint::gear::{self, CORNER, GearLaw, Law, Linear, ThreeSlope};
use strainwave_core::plant::config::{Config, JointConfig};
use strainwave_core::program::Width;
use strainwave_core::sensitivity::{Request, Sensitivities};

pub const LINEAR: Law = Linear::LAW;
pub const THREE_SLOPE: Law = ThreeSlope::LAW;
pub const RIGID: Law = gear::RIGID;

/// A joint with ideal electronics and sensors.
pub fn joint(gear: Law) -> JointConfig {
    JointConfig {
        gear,
        ratio: 0.01,
        torque_per_volt: 0.1,
        current_loop_hz: None,
        encoder_counts: None,
        accelerometer_hz: None,
        gyro_hz: None,
        imu_accelerometer_hz: None,
        imu_gyro_hz: None,
        effects: EffectKinds::default(),
    }
}

/// An arm with geometry for the tests, of a number of joints.
pub trait BuiltIn {
    fn built_in(joints: usize) -> Self;
}

impl BuiltIn for TwoLink<true> {
    fn built_in(_: usize) -> Self {
        Self {
            link_length: 0.35,
            gravity: 9.81,
            accelerometer_distance: [0.3; 2],
        }
    }
}

impl BuiltIn for OneLink {
    fn built_in(_: usize) -> Self {
        Self {
            joint_type: JointType::Revolute,
            gravity: 9.81,
            accelerometer_distance: 0.3,
        }
    }
}

/// A chain with compiled programs.
pub type Chain = SerialChain<MAX_CHAIN_JOINTS>;

/// No two axes are parallel; the second joint of three or more is prismatic.
impl BuiltIn for Chain {
    fn built_in(joints: usize) -> Self {
        let joint = |i: usize| {
            let k = i as f64;
            ChainJoint {
                joint_type: match i {
                    1 if joints > 2 => JointType::Prismatic,
                    _ => JointType::Revolute,
                },
                position: [0.3, 0.05 * k, -0.1],
                attitude: [0.4 - 0.2 * k, 0.5 * k - 0.7, 0.3],
                axis: [0.3 * k, -0.4, 1.0],
                accelerometer_distance: 0.3,
            }
        };
        let joints: Vec<ChainJoint> = (0..joints).map(joint).collect();
        Self::new(&joints, [0.5, -0.3, -9.8]).expect("axes with a direction")
    }
}

pub fn config<A: WithPrograms<N> + BuiltIn, const N: usize>(
    gears: impl AsRef<[Law]>,
) -> Config<A, N> {
    let gears = gears.as_ref();
    let of_joint = |i: usize| joint(*gears.get(i).unwrap_or(&LINEAR));
    Config {
        arm: A::built_in(gears.len()),
        corner: CORNER,
        joints: std::array::from_fn(of_joint),
    }
}

pub fn at_rest<const N: usize>(motor_angle: [f64; N]) -> Initial<N> {
    Initial {
        motor_angle,
        motor_velocity: [0.0; N],
        link_angle: None,
        link_velocity: [0.0; N],
        voltage: [0.0; N],
    }
}

/// Laws of a loop with the states last angle and integral.
///
/// e = w + K (r - y) - (y - last angle) / T, integral+ = integral + T e, v = kp e + ki integral+.
pub fn linear_laws<const N: usize>(servo: &Servo<N>) -> LinearServo<N> {
    let (velocity, gains) = match servo {
        Servo::PiVelocity(velocity) => (velocity, [0.0; N]),
        Servo::PiPosition(position) => (&position.velocity, position.position_gain),
        Servo::LinearServo(_) => unreachable!("a loop"),
    };
    let period = velocity.period;
    let law = |i: usize| {
        let (kp, ki, gain) = (velocity.kp[i], velocity.ki[i], gains[i]);
        let by_inputs = [gain, 1.0, -gain - 1.0 / period];
        let row = |first: f64, second: f64| {
            let mut a = [0.0; MAX_LAW_STATES];
            (a[0], a[1]) = (first, second);
            a
        };
        let last_angle = LawState {
            a: row(0.0, 0.0),
            b: [0.0, 0.0, 1.0],
            c: kp / period + ki,
            e: 0.0,
            holds: false,
            rest: [1.0, 0.0],
        };
        let integral = LawState {
            a: row(1.0, 1.0),
            b: by_inputs.map(|entry| period * entry),
            c: ki,
            e: 0.0,
            holds: true,
            rest: [0.0, if ki > 0.0 { 1.0 / ki } else { 0.0 }],
        };
        let d = by_inputs.map(|entry| (kp + ki * period) * entry);
        let law = JointLaw::new(vec![last_angle, integral], d).expect("two states");
        velocity.active[i].then_some(law)
    };
    LinearServo {
        laws: (0..N).map(law).collect(),
        limit: velocity.limit,
        period,
    }
}

/// A clock with steps of 0.125 ms, and a sample, a tick and a servo reading every eighth step.
pub fn clock(samples: usize) -> Clock {
    Clock {
        step: 1.25e-4,
        steps_per_tick: 8,
        steps_per_servo: 8,
        steps_per_sample: 8,
        samples,
    }
}

/// The two-link arm without gravity.
pub fn level(gears: [Law; 2]) -> Config<TwoLink<true>, 2> {
    let mut config = config::<TwoLink<true>, 2>(gears);
    config.arm.gravity = 0.0;
    config
}

/// The single joint without gravity.
pub fn level_joint(gear: Law) -> Config<OneLink, 1> {
    let mut config = config::<OneLink, 1>([gear]);
    config.arm.gravity = 0.0;
    config
}

/// Simulates with the arm's programs.
pub fn simulate<A: WithPrograms<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    width: Width,
) -> Result<Record<N>, Diverged> {
    task.config.arm.programs().simulate(task, member, width)
}

/// Derivatives with the arm's programs.
pub fn sensitivities<A: WithPrograms<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    let request = Request {
        task,
        member,
        directions,
        variants: &[],
        decimation: None,
    };
    task.config.arm.programs().differentiate(&request, width)
}

/// Derivatives over dual numbers only: slower, for every arm; the reference for the other programs.
pub fn differentiate_over_dual_numbers<A: WithPrograms<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
) -> Result<Sensitivities<N>, Diverged> {
    let request = Request {
        task,
        member,
        directions,
        variants: &[],
        decimation: None,
    };
    (task.config.arm.programs().general.dual_numbers)(&request)
}

/// One run: a sample every step, voltages held for `steps_per_tick` steps.
pub struct Run<'a, A, const N: usize> {
    pub config: Config<A, N>,
    pub parameters: &'a [f64],
    pub voltage: &'a [[f64; N]],
    pub steps_per_tick: usize,
    pub initial: Initial<N>,
    pub step: f64,
    pub steps: usize,
}

impl<A: WithPrograms<N>, const N: usize> Run<'_, A, N> {
    /// The recorded quantities, one row per step.
    pub fn record(&self, quantities: &[Quantity]) -> Record<N> {
        self.record_on(quantities, Width::detect())
    }

    fn record_on(&self, quantities: &[Quantity], width: Width) -> Record<N> {
        let ticks = self.steps / self.steps_per_tick + 1;
        let mut voltage = self.voltage.to_vec();
        voltage.resize(ticks.max(voltage.len()), *self.voltage.last().unwrap());
        let task = Task {
            config: self.config,
            clock: Clock {
                step: self.step,
                steps_per_tick: self.steps_per_tick,
                steps_per_servo: self.steps_per_tick,
                steps_per_sample: 1,
                samples: self.steps + 1,
            },
            servo: None,
            record: quantities.to_vec(),
            link_sensors: Vec::new(),
        };
        task.config.check(self.parameters).expect("a possible arm");
        let reference = vec![[0.0; N]; ticks];
        let member = Member {
            parameters: self.parameters,
            feed_forward: &voltage,
            reference: &reference,
            initial: self.initial,
        };
        simulate(&task, &member, width).expect("finite")
    }
}

/// Reproducible numbers in [-1, 1).
pub struct Draw(SmallRng);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(SmallRng::seed_from_u64(seed))
    }

    pub fn next(&mut self) -> f64 {
        self.0.random_range(-1.0..1.0)
    }
}

/// The built-in SCARA-type arm with linear gears, with or without Coulomb friction and gravity.
pub fn scara(coulomb: f64, gravity: f64) -> Vec<f64> {
    let mut values = vec![1.6097, 0.64425, 0.7875, 31.0 * gravity, 7.4 * gravity];
    values.extend([1.5e-4, 2e-4, 0.06 * coulomb, 0.0, 0.5, 25e3, 20.0, 0.0]);
    values.extend([0.5e-4, 0.8e-4, 0.03 * coulomb, 0.0, 0.15, 6.1e3, 4.0, 0.0]);
    values
}

/// Appends typical values of a size 20 gear for the effects of each joint to the joint's
/// parameters.
pub fn with_effects<A: Arm<N>, const N: usize>(plain: &[f64], config: &Config<A, N>) -> Vec<f64> {
    let mut plain = plain.iter();
    let value = |(name, _): &(&'static str, Option<usize>)| match *name {
        "stribeck_friction" => 0.02,
        "stribeck_velocity" => 3.0,
        "hysteresis_torque" => 2.5,
        "hysteresis_twist" => 1.5e-4,
        "kinematic_error_cos" => 1e-4,
        "kinematic_error_sin" => -5e-5,
        "kinematic_error_order" => 2.0,
        "load_friction" => 0.04,
        "power_friction" => 0.03,
        "power_exponent" => 0.5,
        "torque_ripple_cos" => 0.01,
        "torque_ripple_sin" => -0.006,
        "torque_ripple_order" => 2.0,
        "backlash" => 1e-5,
        "ground_stiffness" => 5.0,
        "ground_preload" => -2.0,
        "dead_zone" => 0.1,
        "drive_gain" => 0.05,
        "drive_saturation" => 0.0125,
        "drive_limit_loss" => 0.4,
        "drive_limit" => 4.0,
        "drive_lag" => 5e-4,
        "tilt_sin" => 1.0,
        "tilt_cos" => -1.5,
        "flexible_inertia" => 0.2,
        "flexible_frequency" => 40.0,
        "flexible_damping" => 0.05,
        "base_compliance" => 1e-5,
        "base_frequency" => 30.0,
        "base_damping" => 0.1,
        _ => *plain.next().expect("a value for every other name"),
    };
    config.parameter_names().iter().map(value).collect()
}

/// Whether a parameter is the size of an effect.
pub fn is_size(name: &str) -> bool {
    let sizes = |effect: &&EffectDeclaration| effect.parameters[..effect.sizes].to_vec();
    let mut all = effects::DECLARATIONS
        .iter()
        .flat_map(|effect| sizes(&effect));
    all.any(|size| size.name == name)
}
