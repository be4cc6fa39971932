//! Time of one step of the integrator [ns] on one core, per program.
//!
//! The arm is the built-in SCARA-type arm with 5 kg at its tip, with a random telegraph voltage on
//! joint 1. Each figure is the minimum of many runs, because other processes slow some of them
//! down.

use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use strainwave_arms::WithPrograms;
use strainwave_core::arm::{ChainJoint, JointType, MAX_CHAIN_JOINTS, SerialChain, TwoLink};
use strainwave_core::experiment::{Clock, Initial, Member, Quantity, Source, Task};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::{CORNER, GearLaw, ThreeSlope};
use strainwave_core::plant::config::{Config, JointConfig};
use strainwave_core::program::Width;
use strainwave_core::sensitivity::Request;
use strainwave_core::sensors::decimation::Decimation;

/// Half a second of motion: short, so that some of many runs are undisturbed.
const STEPS: usize = 4000;
/// Processor time for the runs of a figure [s], of which the fastest counts.
const TIME_PER_FIGURE: f64 = 0.5;
/// Steps of 0.125 ms per tick, servo reading and row.
const STEPS_PER_TICK: usize = 8;

/// Taps of the low-pass per row, as in a whole-arm fit.
const TAPS_PER_ROW: usize = 14;

/// Size [bytes] of a block that is allocated and freed first. glibc keeps freed memory below the
/// size of the largest block freed so far, as in `identify`. Otherwise every run would include
/// clearing the pages of its results.
const KEPT_MEMORY: usize = 31 << 20;

/// Parameters of motors and gears, in the order of their names.
const DRIVES: [[f64; 12]; 2] = [
    [
        1.5e-4, 2e-4, 0.06, 0.0, 0.5, 16e3, 25e3, 29e3, 7.0, 25.0, 20.0, 0.0,
    ],
    [
        0.5e-4, 0.8e-4, 0.03, 0.0, 0.15, 4.7e3, 6.1e3, 7.1e3, 2.0, 6.9, 4.0, 0.0,
    ],
];

fn main() {
    let arguments: Vec<String> = std::env::args().filter(|one| one != "--bench").collect();
    if let [_, arm, width, directions, steps] = &arguments[..] {
        return run_once(arm, width, directions == "derivatives", steps);
    }
    drop(std::hint::black_box(vec![1_u8; KEPT_MEMORY]));
    for &width in Width::available() {
        println!("{width:?} [ns a step]");
        for (name, gravity) in [("horizontal", 0.0), ("vertical", 9.81)] {
            bench_two_link(name, gravity, width);
        }
        bench_chain(3, width);
        bench_chain(6, width);
        bench_chain(7, width);
    }
}

/// One run, whose instructions another program counts.
fn run_once(arm: &str, width: &str, has_derivatives: bool, steps: &str) {
    let is_width = |one: &&Width| format!("{one:?}") == width;
    let width = *Width::available().iter().find(is_width).expect("a width");
    let steps = steps.parse().expect("a number of steps");
    let checksum = match arm {
        "two-link" => two_link(0.0).run_once(width, has_derivatives, steps),
        joints => chain(joints.parse().expect("a number of joints")).run_once(
            width,
            has_derivatives,
            steps,
        ),
    };
    println!("{checksum:016x}");
}

/// The built-in arm, horizontal or under gravity.
fn two_link(gravity: f64) -> Bench<TwoLink<true>, 2> {
    let arm = TwoLink {
        link_length: 0.35,
        gravity,
        accelerometer_distance: [0.33, 0.27],
    };
    let links = links_of_two(gravity);
    let parameters = [&links, DRIVES.as_flattened()].concat();
    Bench::new(arm, &parameters, STEPS_PER_TICK, &[Quantity::MotorVelocity])
}

/// Parameters of the links of the built-in arm.
fn links_of_two(gravity: f64) -> [f64; 5] {
    [1.6097, 0.64425, 0.7875, gravity * 3.2, gravity * 0.75]
}

fn bench_two_link(name: &str, gravity: f64, width: Width) {
    let plain = two_link(gravity);
    println!(
        "{name} two-link arm, simulation: {:.1}, several at once {:.1} each",
        plain.simulation(width),
        plain.together(width)
    );
    let sensors = [Quantity::MotorVelocity, Quantity::Accelerometer];
    let block_sensors = Bench::new(plain.task.config.arm, &plain.parameters, 1, &sensors);
    let taps = vec![vec![0.01; TAPS_PER_ROW * STEPS_PER_TICK]; sensors.len()];
    let low_pass = Decimation::new(taps, STEPS_PER_TICK);
    let varied = block_sensors.directions(&["gravity_torque_1", "gravity_torque_2"]);
    for count in [15, 25] {
        let directions = &varied[..count];
        println!(
            "{name} two-link arm, {count} derivatives: {:.1}, with sensors through a low-pass {:.1}",
            plain.derivatives(directions, None, width),
            block_sensors.derivatives(directions, low_pass.as_ref(), width),
        );
    }
    let mut stribeck = plain;
    for joint in &mut stribeck.task.config.joints {
        joint.effects.stribeck = true;
    }
    let ([first, second], links) = (DRIVES, links_of_two(gravity));
    stribeck.parameters = [&links[..], &first, &[0.02, 3.0], &second, &[0.01, 3.0]].concat();
    let one = &stribeck.directions(&[])[..1];
    println!(
        "{name} two-link arm with Stribeck friction, simulation: {:.1}, with one derivative {:.1}",
        stribeck.simulation(width),
        stribeck.derivatives(one, None, width),
    );
}

/// A chain of equal links and drives under gravity.
fn chain(count: usize) -> Bench<SerialChain<MAX_CHAIN_JOINTS>, MAX_CHAIN_JOINTS> {
    let joint = |i: usize| ChainJoint {
        joint_type: JointType::Revolute,
        position: [0.0, 0.0, 0.2],
        attitude: [std::f64::consts::FRAC_PI_2 * (i % 2) as f64, 0.0, 0.0],
        axis: [0.0, 0.0, 1.0],
        accelerometer_distance: 0.1,
    };
    let joints: Vec<ChainJoint> = (0..count).map(joint).collect();
    let arm: SerialChain<MAX_CHAIN_JOINTS> =
        SerialChain::new(&joints, [0.0, 0.0, -9.81]).expect("axes with a direction");
    let mut chain = Bench::new(arm, &[], STEPS_PER_TICK, &[Quantity::MotorVelocity]);
    let value = |name: &str| match name {
        "link_mass" => 2.0,
        "link_inertia_xx" | "link_inertia_yy" | "link_inertia_zz" => 0.05,
        _ => 0.0,
    };
    let names = chain.task.config.parameter_names();
    let links = names.iter().filter(|name| name.0.starts_with("link_"));
    let links = links.filter(|name| name.0 != "link_viscous_friction");
    chain.parameters = links.map(|name| value(name.0)).collect();
    chain.parameters.extend(DRIVES[0].repeat(count));
    chain
}

/// A plain run of a chain, and one with derivatives by all parameters that change the motion.
fn bench_chain(count: usize, width: Width) {
    let chain = chain(count);
    let all = chain.directions(&[]);
    let (plain, varied) = (
        chain.simulation(width),
        chain.derivatives(&all, None, width),
    );
    println!(
        "chain of {count}, simulation: {plain:.0}, several at once {:.0} each, with {} derivatives \
         {varied:.0}: {:.1} plain runs",
        chain.together(width),
        all.len(),
        varied / plain
    );
}

/// An arm and its experiment.
struct Bench<A, const N: usize> {
    task: Task<A, N>,
    parameters: Vec<f64>,
    voltage: Vec<[f64; N]>,
}

impl<A: WithPrograms<N>, const N: usize> Bench<A, N> {
    /// The arm with a random telegraph voltage on joint 1.
    fn new(arm: A, parameters: &[f64], steps_per_sample: usize, record: &[Quantity]) -> Self {
        let joint = |i: usize| JointConfig {
            gear: ThreeSlope::LAW,
            ratio: 0.01,
            torque_per_volt: if i == 0 { 0.08 } else { 0.03 },
            current_loop_hz: Some(1000.0),
            encoder_counts: Some(8192.0),
            accelerometer_hz: Some(300.0),
            gyro_hz: Some(5.0),
            imu_accelerometer_hz: None,
            imu_gyro_hz: None,
            effects: EffectKinds::default(),
        };
        let mut draw = SmallRng::seed_from_u64(1);
        let mut tick = || {
            let mut voltage = [0.0; N];
            voltage[0] = if draw.random() { 10.0 } else { -10.0 };
            voltage
        };
        Self {
            task: Task {
                config: Config {
                    arm,
                    corner: CORNER,
                    joints: std::array::from_fn(joint),
                },
                clock: Clock {
                    step: 1.25e-4,
                    steps_per_tick: STEPS_PER_TICK,
                    steps_per_servo: STEPS_PER_TICK,
                    steps_per_sample,
                    samples: STEPS / steps_per_sample + 1,
                },
                servo: None,
                record: record.to_vec(),
                link_sensors: Vec::new(),
            },
            parameters: parameters.to_vec(),
            voltage: (0..=STEPS / STEPS_PER_TICK).map(|_| tick()).collect(),
        }
    }

    /// All parameters that change the motion, except those in `without`.
    fn directions(&self, without: &[&str]) -> Vec<Source> {
        let names = self.task.config.parameter_names();
        let varies =
            |k: &usize| names[*k].0 != "friction_settling_time" && !without.contains(&names[*k].0);
        (0..names.len())
            .filter(varies)
            .map(Source::Parameter)
            .collect()
    }

    fn member(&self) -> Member<'_, N> {
        Member {
            parameters: &self.parameters,
            feed_forward: &self.voltage,
            reference: &self.voltage,
            initial: Initial {
                motor_angle: [0.0; N],
                motor_velocity: [0.0; N],
                link_angle: None,
                link_velocity: [0.0; N],
                voltage: [0.0; N],
            },
        }
    }

    /// Checksum of the results of a run of some steps.
    fn run_once(mut self, width: Width, has_derivatives: bool, steps: usize) -> u64 {
        let programs = self.task.config.arm.programs();
        self.task.clock.samples = steps / STEPS_PER_TICK + 1;
        let directions = self.directions(&[]);
        let (task, member) = (&self.task, &self.member());
        let (values, tangents) = if has_derivatives {
            let request = Request {
                task,
                member,
                directions: &directions,
                variants: &[],
                decimation: None,
            };
            let all = programs.differentiate(&request, width).expect("finite");
            (all.values, all.tangents)
        } else {
            let record = programs.simulate(task, member, width).expect("finite");
            (record, Vec::new())
        };
        let all = values.iter().flat_map(|rows| rows.as_flattened());
        let all = all.chain(tangents.iter().flatten());
        all.fold(0, |sum, number| sum.rotate_left(1) ^ number.to_bits())
    }

    fn simulation(&self, width: Width) -> f64 {
        let programs = self.task.config.arm.programs();
        let member = self.member();
        self.shortest_time(|| assert!(programs.simulate(&self.task, &member, width).is_ok()))
    }

    /// Time of a step per experiment, of as many at once as a register has lanes [ns].
    fn together(&self, width: Width) -> f64 {
        let programs = self.task.config.arm.programs();
        let cases = vec![(self.task.clone(), self.member()); width.lanes()];
        let all = || {
            programs
                .simulate_all(&cases, width)
                .iter()
                .all(Result::is_ok)
        };
        self.shortest_time(|| assert!(all())) / cases.len() as f64
    }

    fn derivatives(
        &self,
        directions: &[Source],
        decimation: Option<&Decimation>,
        width: Width,
    ) -> f64 {
        let programs = self.task.config.arm.programs();
        let request = Request {
            task: &self.task,
            member: &self.member(),
            directions,
            variants: &[],
            decimation,
        };
        self.shortest_time(|| assert!(programs.differentiate(&request, width).is_ok()))
    }

    /// Minimum time of a step [ns].
    fn shortest_time(&self, run: impl Fn()) -> f64 {
        let (begin, mut shortest) = (processor_time(), f64::INFINITY);
        while processor_time() - begin < TIME_PER_FIGURE {
            let begin = processor_time();
            run();
            shortest = shortest.min(processor_time() - begin);
        }
        1e9 * shortest / STEPS as f64
    }
}

/// Processor time of this thread [s]; other processes do not add to it.
#[cfg(unix)]
fn processor_time() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the pointer is valid, and every Unix has the clock.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    assert_eq!(status, 0);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Time since the first call [s], where there is no such clock.
#[cfg(not(unix))]
fn processor_time() -> f64 {
    static START: std::sync::LazyLock<std::time::Instant> =
        std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed().as_secs_f64()
}
