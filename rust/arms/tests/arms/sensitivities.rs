//! Derivatives of experiments against differences of the plain simulation.

use std::iter::zip;

use crate::common::{
    BuiltIn, Chain, Draw, LINEAR, RIGID, THREE_SLOPE, config, differentiate_over_dual_numbers,
    linear_laws, sensitivities, simulate,
};
use proptest::prelude::*;
use strainwave_arms::WithPrograms;
use strainwave_core::actuation::{PiVelocity, Servo};
use strainwave_core::arm::link_signals::{LINK_SIGNALS, LinkSensor};
use strainwave_core::arm::{
    Arm, ChainJoint, JointType, MAX_CHAIN_JOINTS, OneLink, Transmission, TwoLink,
};
use strainwave_core::experiment::{Clock, Initial, Member, Quantity, Record, Source, Task};
use strainwave_core::joint::effects::EffectKinds;
use strainwave_core::joint::gear::Law;
use strainwave_core::plant::config::Config;
use strainwave_core::program::Width;
use strainwave_core::sensitivity::{Request, Sensitivities, Variant};

/// Quantities whose derivatives are checked.
const RECORDED: [Quantity; SLIDING + 1] = {
    let mut all = [Quantity::Sliding; SLIDING + 1];
    let others = [
        Quantity::MotorAngle,
        Quantity::MotorVelocity,
        Quantity::LinkAngle,
        Quantity::LinkVelocity,
        Quantity::LinkAcceleration,
        Quantity::GearTorque,
        Quantity::Torsion,
        Quantity::Encoder,
        Quantity::Accelerometer,
        Quantity::Gyro,
        Quantity::Voltage,
        Quantity::MotorTorque,
    ];
    let mut k = 0;
    while k < SLIDING {
        all[k] = match k.checked_sub(others.len()) {
            None => others[k],
            Some(sensor) => Quantity::LinkSensor(sensor),
        };
        k += 1;
    }
    all
};
/// Index of the friction modes in [`RECORDED`], which is the last.
const SLIDING: usize = 12 + LINK_SIGNALS + 2;

/// The signals of links one by one, and an accelerometer and a gyro at irregular places.
fn link_sensors(joints: usize) -> Vec<LinkSensor> {
    let irregular = |is_gyro| LinkSensor {
        is_gyro,
        weights: (0..joints)
            .map(|i| std::array::from_fn(|k| (1.3 * k as f64 + 0.7 * i as f64).sin()))
            .collect(),
    };
    (0..LINK_SIGNALS)
        .map(|signal| LinkSensor::of_signal(signal, joints))
        .chain([false, true].map(irregular))
        .collect()
}

/// A random experiment.
struct Case<A, const N: usize> {
    task: Task<A, N>,
    parameters: Vec<f64>,
    /// Typical size of each parameter if it is not zero.
    typical: Vec<f64>,
    initial: Initial<N>,
    voltage: Vec<[f64; N]>,
    reference: Vec<[f64; N]>,
}

impl<A: WithPrograms<N> + BuiltIn, const N: usize> Case<A, N> {
    /// A random arm: a two-link or one-link arm with the built-in parameters varied by some tens of
    /// percent, under random telegraph voltages or a servo.
    fn random(gears: impl AsRef<[Law]>, seed: u64, servo: bool, steps: usize) -> Self {
        Self::random_with(EffectKinds::default(), gears, seed, servo, steps)
    }

    /// A random arm with effects, except those that a rigid gear cannot have.
    fn random_with(
        effects: EffectKinds,
        gears: impl AsRef<[Law]>,
        seed: u64,
        servo: bool,
        steps: usize,
    ) -> Self {
        let mut draw = Draw::new(seed);
        let mut config: Config<A, N> = config(gears);
        for joint in &mut config.joints {
            let elastic = joint.gear != RIGID;
            joint.effects = effects;
            if !elastic {
                joint.effects.hysteresis = false;
                joint.effects.kinematic_error = false;
                joint.effects.load_friction = false;
                joint.effects.backlash = false;
                joint.effects.soft_base = false;
            }
            joint.current_loop_hz = Some(800.0 + 200.0 * draw.next());
            joint.accelerometer_hz = Some(300.0);
            joint.gyro_hz = Some(5.0);
            joint.imu_accelerometer_hz = Some(250.0);
            joint.imu_gyro_hz = Some(40.0);
        }
        let parameters = random_parameters(&config, &mut draw);
        let clock = Clock {
            step: 1.25e-4,
            steps_per_tick: 8,
            steps_per_servo: 16,
            steps_per_sample: 1,
            samples: steps + 1,
        };
        let servo = servo.then_some(Servo::PiVelocity(PiVelocity {
            kp: [0.6; N],
            ki: [9.0; N],
            limit: 12.0,
            period: 2e-3,
            active: [true; N],
        }));
        let volts = if servo.is_some() { 0.3 } else { 6.0 };
        let mut telegraph = |size: f64| -> Vec<[f64; N]> {
            (0..=steps / 8)
                .map(|_| std::array::from_fn(|_| size * draw.next().signum()))
                .collect()
        };
        let (voltage, reference) = (telegraph(volts), telegraph(4.0));
        let joints = config.arm.joints();
        let mut some = |size: f64| {
            let mut row = [0.0; N];
            row[..joints].fill_with(|| size * draw.next());
            row
        };
        let initial = Initial {
            motor_angle: some(20.0),
            motor_velocity: some(10.0),
            link_angle: None,
            link_velocity: some(0.1),
            voltage: [0.0; N],
        };
        Self {
            task: Task {
                config,
                clock,
                servo,
                record: RECORDED.to_vec(),
                link_sensors: link_sensors(config.arm.joints()),
            },
            typical: parameters.clone(),
            parameters,
            initial,
            voltage,
            reference,
        }
    }

    /// The same arm with a matrix between motors and joints; motor 2 turns in the other direction.
    fn coupled(mut self) -> Self
    where
        A: Coupled<N>,
    {
        let n = self.joints();
        let entry = |i: usize, j: usize| match i {
            _ if i == j => 1.0,
            _ if i.max(j) >= n => 0.0,
            _ => 0.3 * ((3 * i + 5 * j) as f64).sin(),
        };
        let matrix = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
        self.task.config.arm = self.task.config.arm.coupled(&matrix);
        self.task.config.joints[1].ratio *= -1.0;
        self
    }

    /// The same arm under linear laws that are equal to its servo.
    fn under_linear_laws(mut self) -> Self {
        let servo = self.task.servo.as_ref().expect("a servo");
        self.task.servo = Some(Servo::LinearServo(linear_laws(servo)));
        self
    }

    /// The same arm with all effect sizes zero; derivatives with respect to the sizes remain
    /// available.
    fn without_effects(mut self) -> Self {
        for (value, (name, _)) in zip(&mut self.parameters, self.task.config.parameter_names()) {
            if crate::common::is_size(name) {
                *value = 0.0;
            }
        }
        self
    }

    /// The same arm with the sizes of all effects zero but those of the drive.
    fn with_drive_effects_only(mut self) -> Self {
        for (value, (name, _)) in zip(&mut self.parameters, self.task.config.parameter_names()) {
            if crate::common::is_size(name) && !name.starts_with("drive_") {
                *value = 0.0;
            }
        }
        self
    }

    fn joints(&self) -> usize {
        self.task.config.arm.joints()
    }

    /// All parameters and all initial states.
    fn directions(&self) -> Vec<Source> {
        // without a settling time a motor stops instantly, and its time has no derivative
        let names = self.task.config.parameter_names();
        let stops = |k: &usize| names[*k].0 == "friction_settling_time";
        let varied = |k: &usize| !stops(k) || self.parameters[*k] > 0.0;
        let parameters = (0..names.len()).filter(varied).map(Source::Parameter);
        let states = (0..self.joints()).flat_map(|i| {
            [
                Source::MotorAngle(i),
                Source::MotorVelocity(i),
                Source::LinkAngle(i),
                Source::LinkVelocity(i),
            ]
        });
        parameters.chain(states).collect()
    }

    fn member<'a>(&'a self, parameters: &'a [f64], initial: Initial<N>) -> Member<'a, N> {
        Member {
            parameters,
            feed_forward: &self.voltage,
            reference: &self.reference,
            initial,
        }
    }

    fn differentiate(&self, directions: &[Source], width: Width) -> Sensitivities<N> {
        let member = self.member(&self.parameters, self.initial);
        sensitivities(&self.task, &member, directions, width).expect("finite")
    }

    /// The plain experiment with one parameter or initial state changed.
    fn perturbed(&self, source: Source, by: f64, equilibrium: &[f64; N]) -> Record<N> {
        let (mut parameters, mut initial) = (self.parameters.clone(), self.initial);
        match source {
            Source::Parameter(k) => parameters[k] += by,
            Source::MotorAngle(i) => initial.motor_angle[i] += by,
            Source::MotorVelocity(i) => initial.motor_velocity[i] += by,
            Source::LinkVelocity(i) => initial.link_velocity[i] += by,
            Source::LinkAngle(i) => {
                let mut angle = *equilibrium;
                angle[i] += by;
                initial.link_angle = Some(angle);
            }
            Source::Nothing => {}
        }
        let member = self.member(&parameters, initial);
        simulate(&self.task, &member, Width::detect()).expect("finite")
    }

    /// Change of a parameter or initial state by `part` of its typical size.
    fn size(&self, source: Source, part: f64) -> f64 {
        part * match source {
            Source::Parameter(k) => self.typical[k].abs(),
            Source::MotorAngle(_) | Source::MotorVelocity(_) => 10.0,
            Source::LinkAngle(_) => 0.01,
            Source::LinkVelocity(_) => 1.0,
            Source::Nothing => 0.0,
        }
    }
}

impl Case<TwoLink<true>, 2> {
    /// The same arm without gravity.
    fn level(mut self) -> Self {
        self.task.config.arm.gravity = 0.0;
        self
    }
}

fn random_parameters<A: Arm<N>, const N: usize>(
    config: &Config<A, N>,
    draw: &mut Draw,
) -> Vec<f64> {
    let settling = f64::from(u8::from(draw.next() > 0.0));
    let mut around = |value: f64| value * (1.0 + 0.3 * draw.next());
    config
        .parameter_names()
        .iter()
        .map(|(name, joint)| {
            let second = *joint == Some(2);
            let either = |first: f64, other: f64| if second { other } else { first };
            around(match *name {
                "alpha" => 2.0,
                "beta" => 0.7,
                "gamma" => 0.5,
                "link_inertia" => 1.5,
                "link_mass" => 4.0,
                "link_first_moment_x" => 0.15,
                "link_first_moment_y" | "link_first_moment_z" => -0.05,
                "link_inertia_xx" | "link_inertia_yy" | "link_inertia_zz" => 0.35,
                "link_inertia_xy" | "link_inertia_xz" | "link_inertia_yz" => 0.004,
                "gravity_torque_1" => 31.0,
                "gravity_torque_2" => 7.0,
                "motor_inertia" => either(1.5e-4, 0.5e-4),
                "motor_viscous_friction" => either(2e-4, 0.8e-4),
                "motor_coulomb_friction" => either(0.08, 0.04),
                "friction_offset" => 0.01,
                "link_viscous_friction" => either(0.5, 0.15),
                "gear_stiffness" => either(25e3, 6e3),
                "gear_stiffness_cubic" => either(5e9, 2e9),
                "gear_stiffness_k1" => either(16e3, 4.7e3),
                "gear_stiffness_k2" => either(25e3, 6.1e3),
                "gear_stiffness_k3" => either(29e3, 7.1e3),
                "gear_knee_t1" => either(7.0, 2.0),
                "gear_knee_t2" => either(25.0, 6.9),
                "gear_damping" => either(20.0, 4.0),
                "friction_settling_time" => settling * either(1.5e-4, 4e-4),
                "stribeck_friction" => either(0.02, 0.01),
                "stribeck_velocity" => 3.0,
                "hysteresis_torque" => either(2.5, 0.6),
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
                "base_compliance" => either(1e-5, 4e-5),
                "base_frequency" => 30.0,
                "base_damping" => 0.1,
                _ => unreachable!("{name}"),
            })
        })
        .collect()
}

/// Step lengths of the differences: 10^-2 to 10^-7 of the typical size of the varied quantity.
const DIGITS: std::ops::RangeInclusive<i32> = 2..=7;

/// Checks every derivative against differences, relative to the largest entry of its column.
/// Returns the share of directions that could be checked.
///
/// At the rounded knees the slopes change rapidly: a difference over a long step misses the change,
/// and one over a short step has more rounding. The derivative must agree with one of several step
/// lengths. A direction is omitted if all steps but the shortest change the step in which a motor
/// sticks or slides.
fn check<A: WithPrograms<N> + BuiltIn, const N: usize>(case: &Case<A, N>) -> f64 {
    let directions = case.directions();
    let actual = case.differentiate(&directions, Width::detect());
    let plain = case.perturbed(Source::Parameter(0), 0.0, &[0.0; N]);
    let differences: Vec<Vec<Differences<N>>> = directions
        .iter()
        .map(|&direction| {
            let sizes = DIGITS.map(|digits| case.size(direction, 0.1f64.powi(digits)));
            let actual = sizes.filter_map(|size| Differences::of(case, direction, size, &plain));
            let actual: Vec<_> = actual.collect();
            if actual.len() > 1 { actual } else { Vec::new() }
        })
        .collect();
    for k in 0..RECORDED.len() {
        let rounding = rounding(case, &directions, &differences, &plain, k);
        for (d, direction) in directions.iter().enumerate() {
            let computed = rows_of(case, &actual.tangents[k], directions.len(), d);
            let error = distance(&computed, &differences[d], &rounding, k);
            assert!(error < 1e-7, "{direction:?} {:?}: {error:e}", RECORDED[k]);
        }
    }
    let checked = differences.iter().filter(|lengths| !lengths.is_empty());
    checked.count() as f64 / directions.len() as f64
}

/// Bound of the rounding error of a difference of one quantity, times the step length.
///
/// A servo loop can double the rounding error every few readings: voltages differed by 6e-11 of
/// their maximum, and the error of the differences grew with shorter steps. The bound is therefore
/// measured. For the shortest steps, eighth differences contain only rounding. Rounding with
/// standard deviation s gives eighth differences with standard deviation sqrt(12870) s and slopes
/// with 1.2 s. The maximum over all rows and directions represents several standard deviations.
fn rounding<A: WithPrograms<N> + BuiltIn, const N: usize>(
    case: &Case<A, N>,
    directions: &[Source],
    differences: &[Vec<Differences<N>>],
    plain: &Record<N>,
    k: usize,
) -> [f64; N] {
    let mut actual = [0.0f64; N];
    for i in 0..N {
        actual[i] = plain[k].iter().fold(0.0, |a, row| row[i].abs().max(a)) * 1e-11;
    }
    for (&direction, lengths) in zip(directions, differences) {
        let shortest = case.size(direction, 0.1f64.powi(*DIGITS.end()));
        for each in lengths.iter().filter(|each| each.size < 2.0 * shortest) {
            for row in &each.eighth[k] {
                for i in 0..N {
                    actual[i] = actual[i].max(2.0 / 12_870f64.sqrt() * row[i].abs());
                }
            }
        }
    }
    actual
}

/// Derivatives in one direction, with zeros beyond the arm's joints.
fn rows_of<A: WithPrograms<N> + BuiltIn, const N: usize>(
    case: &Case<A, N>,
    tangents: &[f64],
    width: usize,
    d: usize,
) -> Vec<[f64; N]> {
    let entry = |row: &[f64], i: usize| row.get(i * width + d).copied().unwrap_or(0.0);
    tangents
        .chunks(case.joints() * width)
        .map(|row| std::array::from_fn(|i| entry(row, i)))
        .collect()
}

/// Largest distance from the closest difference, relative to the largest entry of each column.
///
/// Two contributions are subtracted: the rounding error of a difference, and the smallest change
/// between differences over successive step lengths, because near a knee even the shortest step may
/// not have converged.
fn distance<const N: usize>(
    computed: &[[f64; N]],
    differences: &[Differences<N>],
    rounding: &[f64; N],
    k: usize,
) -> f64 {
    if differences.is_empty() {
        return 0.0;
    }
    let mut worst = 0.0f64;
    for i in 0..N {
        let scale = computed.iter().fold(0.0f64, |a, row| a.max(row[i].abs()));
        for row in 0..computed.len() {
            let error = |each: &Differences<N>| {
                let error = (computed[row][i] - each.slopes[k][row][i]).abs();
                (error - rounding[i] / each.size).max(0.0)
            };
            let change = |pair: &[Differences<N>]| {
                let [one, other] = [0, 1].map(|length| pair[length].slopes[k][row][i]);
                (one - other).abs()
            };
            let smallest = differences.iter().map(error).fold(f64::INFINITY, f64::min);
            let unsettled = differences.windows(2).map(change).reduce(f64::min);
            let beyond = (smallest - unsettled.unwrap_or(0.0)).max(0.0);
            worst = worst.max(beyond / scale.max(f64::MIN_POSITIVE));
        }
    }
    worst
}

/// Central differences for one step length.
struct Differences<const N: usize> {
    size: f64,
    /// Differences of eighth order.
    slopes: Record<N>,
    /// Eighth differences, not divided by the step length.
    eighth: Record<N>,
}

impl<const N: usize> Differences<N> {
    /// Differences for a step length; `None` if the pattern of sliding changes.
    fn of<A: WithPrograms<N> + BuiltIn>(
        case: &Case<A, N>,
        direction: Source,
        size: f64,
        plain: &Record<N>,
    ) -> Option<Self> {
        // central differences: first derivative to eighth order, eighth difference
        const WEIGHTS: [f64; 4] = [4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0];
        const EIGHTH: [f64; 4] = [-56.0, 28.0, -8.0, 1.0];
        let equilibrium = plain[2][0];
        let mut actual = Self {
            size,
            slopes: plain
                .iter()
                .map(|rows| vec![[0.0; N]; rows.len()])
                .collect(),
            eighth: plain.clone(),
        };
        for entry in actual
            .eighth
            .iter_mut()
            .flat_map(|rows| rows.as_flattened_mut())
        {
            *entry *= 70.0;
        }
        for j in 0..WEIGHTS.len() {
            let by = size * (j + 1) as f64;
            for sign in [1.0, -1.0] {
                let perturbed = case.perturbed(direction, sign * by, &equilibrium);
                if perturbed[SLIDING] != plain[SLIDING] {
                    return None;
                }
                add(&mut actual.slopes, sign * WEIGHTS[j] / size, &perturbed);
                add(&mut actual.eighth, EIGHTH[j], &perturbed);
            }
        }
        Some(actual)
    }
}

fn add<const N: usize>(sum: &mut Record<N>, weight: f64, record: &Record<N>) {
    for (sum, rows) in zip(sum, record) {
        for (sum, value) in zip(sum.as_flattened_mut(), rows.as_flattened()) {
            *sum += weight * value;
        }
    }
}

/// Largest distance between two results, relative to the largest entry of each column. The scale is
/// at least 1e-4 of the value per typical size of the direction, because smaller columns contain
/// only rounding.
fn relative_difference<A: WithPrograms<N> + BuiltIn, const N: usize>(
    case: &Case<A, N>,
    directions: &[Source],
    [one, other]: [&Sensitivities<N>; 2],
) -> f64 {
    let width = directions.len();
    let mut worst = 0.0f64;
    for k in 0..RECORDED.len() {
        for (d, &direction) in directions.iter().enumerate() {
            let computed: Vec<[f64; N]> = rows_of(case, &one.tangents[k], width, d);
            let others: Vec<[f64; N]> = rows_of(case, &other.tangents[k], width, d);
            for i in 0..N {
                let largest =
                    |rows: &[[f64; N]]| rows.iter().fold(0.0f64, |a, row| a.max(row[i].abs()));
                let smallest = 1e-4 * largest(&one.values[k]) / case.size(direction, 1.0);
                let scale = largest(&computed).max(smallest).max(f64::MIN_POSITIVE);
                for (computed, other) in computed.iter().zip(&others) {
                    worst = worst.max((computed[i] - other[i]).abs() / scale);
                }
            }
        }
    }
    worst
}

/// Compares experiments simulated together, which differ in everything but arm and clock, with those
/// simulated alone.
fn check_together<A: WithPrograms<N> + BuiltIn, const N: usize>(
    gears: impl AsRef<[Law]>,
    seed: u64,
    steps: usize,
) {
    let gears = gears.as_ref();
    let one =
        |k: u64| Case::<A, N>::random(gears, seed.wrapping_add(k), k.is_multiple_of(3), steps);
    let mut cases: Vec<_> = (0..11).map(one).collect();
    let config = cases[0].task.config;
    for (k, case) in cases.iter_mut().enumerate() {
        case.task.config = config;
        case.task.clock.samples -= 7 * k;
    }
    let members = cases.iter().map(|case| {
        let member = case.member(&case.parameters, case.initial);
        (case.task.clone(), member)
    });
    let members: Vec<_> = members.collect();
    for &width in Width::available() {
        let together = config.arm.programs().simulate_all(&members, width);
        for ((task, member), together) in zip(&members, together) {
            let alone = simulate(task, member, width).expect("finite");
            let together = together.expect("finite");
            for (alone, together) in zip(alone.concat(), together.concat()) {
                for i in 0..config.arm.joints() {
                    let error = (alone[i] - together[i]).abs();
                    assert!(error < 1e-8 * (1.0 + alone[i].abs()), "{error:e} {width:?}");
                }
            }
        }
    }
}

/// An arm that may have a transmission.
trait Coupled<const N: usize> {
    fn coupled(&self, matrix: &[[f64; N]; N]) -> Self;
}

impl Coupled<MAX_CHAIN_JOINTS> for Chain {
    fn coupled(&self, matrix: &[[f64; MAX_CHAIN_JOINTS]; MAX_CHAIN_JOINTS]) -> Self {
        self.with_transmission(Transmission::new(matrix).expect("a regular matrix"))
    }
}

/// Compares derivatives by the variational equations with derivatives over dual numbers.
/// Variants of effects of size zero give the derivatives of experiments of their own.
fn check_variants<A: WithPrograms<N> + BuiltIn, const N: usize>(case: &Case<A, N>) {
    let names = case.task.config.parameter_names();
    let sizes = |every: usize| -> Vec<Source> {
        let of_effects = (0..names.len()).filter(|&k| crate::common::is_size(names[k].0));
        of_effects.step_by(every).map(Source::Parameter).collect()
    };
    let with_shapes = |factor: f64| -> Vec<f64> {
        let is_shape = |name: &str| SHAPES.iter().any(|end| name.ends_with(end));
        let scaled = |(&value, &(name, _)): (&f64, &(&str, _))| match is_shape(name) {
            true => factor * value,
            false => value,
        };
        zip(&case.parameters, &names).map(scaled).collect()
    };
    let shapes = [with_shapes(0.5), with_shapes(2.0)];
    let of_variants = [sizes(1), sizes(5)];
    let variants: Vec<_> = zip(&shapes, &of_variants)
        .map(|(parameters, directions)| Variant {
            parameters,
            directions,
        })
        .collect();
    let member = case.member(&case.parameters, case.initial);
    let directions = case.directions();
    for &width in Width::available() {
        let request = Request {
            task: &case.task,
            member: &member,
            directions: &directions,
            variants: &variants,
            decimation: None,
        };
        let programs = case.task.config.arm.programs();
        let together = programs.differentiate(&request, width).expect("finite");
        let mut alone = case.differentiate(&directions, width);
        let mut count = directions.len();
        for (parameters, sizes) in zip(&shapes, &of_variants) {
            let member = case.member(parameters, case.initial);
            let other = sensitivities(&case.task, &member, sizes, width).expect("finite");
            alone.append(&other, [count, sizes.len()]);
            count += sizes.len();
        }
        assert!(together == alone, "on {width:?}"); // both are long
    }
}

/// Ends of names of parameters of effects without influence at size zero.
const SHAPES: [&str; 5] = ["_velocity", "_twist", "_order", "_frequency", "drive_limit"];

fn check_methods<A: WithPrograms<N> + BuiltIn, const N: usize>(case: &Case<A, N>) {
    let member = case.member(&case.parameters, case.initial);
    let directions = case.directions();
    let width = Width::detect();
    let slow = differentiate_over_dual_numbers(&case.task, &member, &directions).expect("finite");
    let fast = case.differentiate(&directions, width);
    if A::PLANAR {
        assert_eq!(slow.values, fast.values);
    }
    // a chain's links are added in another order if a register holds several of them
    let values = |run: &Sensitivities<N>| run.values.concat();
    for (one, other) in values(&slow).iter().zip(&values(&fast)) {
        // entries beyond the joints have no meaning
        for (one, other) in one.iter().zip(other).take(case.task.config.arm.joints()) {
            assert!(
                (one - other).abs() < 1e-9 * (1.0 + one.abs()),
                "{one} {other}"
            );
        }
    }
    // Dual numbers compute the derivative of a torsion as the difference of two numbers that are
    // 10^5 times as large, and a servo loop can double the rounding error every few reversals.
    let error = relative_difference(case, &directions, [&slow, &fast]);
    assert!(error < 1e-6, "{error:e}");
    for &other in Width::available().iter().filter(|&&other| other != width) {
        let error = relative_difference(
            case,
            &directions,
            [&fast, &case.differentiate(&directions, other)],
        );
        assert!(error < 1e-6, "{error:e} on {other:?}");
    }
    let few = [directions[7], directions[0], directions[2]];
    let some = case.differentiate(&few, width);
    for (d, direction) in few.iter().enumerate() {
        let at = directions.iter().position(|all| all == direction).unwrap();
        for k in 0..RECORDED.len() {
            let computed: Vec<[f64; N]> = rows_of(case, &some.tangents[k], 3, d);
            assert_eq!(
                computed,
                rows_of(case, &fast.tangents[k], directions.len(), at)
            );
        }
    }
}

/// In this case even the shortest steps with the same pattern of sliding reach a knee.
#[test]
fn derivatives_match_where_differences_have_not_converged() {
    let kinds = EffectKinds {
        hysteresis: false,
        ..SMOOTH
    };
    check(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(
        kinds,
        [LINEAR, RIGID],
        980_182_916_517_365_455,
        true,
        160,
    ));
}

/// In this case the torsion of a gear at rest is rounding only, of either sign.
#[test]
fn methods_agree_for_zero_backlash_at_rest() {
    let gears = [THREE_SLOPE, LINEAR];
    let arm =
        Case::<TwoLink<true>, 2>::random_with(ALL, gears, 1_343_806_162_293_110_939, false, 400)
            .level();
    check_methods(&arm.without_effects());
}

/// In this case the servo loop amplifies the rounding error of the voltages and of the differences.
#[test]
fn derivatives_match_where_servo_amplifies_rounding() {
    check(&Case::<TwoLink<true>, 2>::random(
        [LINEAR, THREE_SLOPE],
        3_105_188_054_994_044_978,
        true,
        240,
    ));
}

/// A row of a planar arm as one of a chain.
fn padded<T: Copy + Default>([first, second]: [T; 2]) -> [T; MAX_CHAIN_JOINTS] {
    let mut row = [T::default(); MAX_CHAIN_JOINTS];
    (row[0], row[1]) = (first, second);
    row
}

/// Compares a planar arm with the equivalent chain in one experiment.
///
/// With masses m, first moments h and inertias I of the links, alpha = I_1 + m_2 l^2, beta = I_2,
/// gamma = l h_2, G_1 = g (h_1 + m_2 l) and G_2 = g h_2.
fn check_planar_chain(seed: u64, servo: bool) {
    let mut planar = Case::<TwoLink<true>, 2>::random([THREE_SLOPE, LINEAR], seed, servo, 240);
    let (l, g) = (0.35, 9.81);
    let links = [[6.0, 0.9, 0.5], [3.0, 0.4, 0.3]]; // m, h, I
    let [[_, h_1, i_1], [m_2, h_2, i_2]] = links;
    planar.parameters[..5].copy_from_slice(&[
        i_1 + m_2 * l * l,
        i_2,
        l * h_2,
        g * (h_1 + m_2 * l),
        g * h_2,
    ]);
    let joint = |position| ChainJoint {
        joint_type: JointType::Revolute,
        position,
        attitude: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        accelerometer_distance: 0.3,
    };
    let joints = [joint([0.0; 3]), joint([l, 0.0, 0.0])];
    let config = Config {
        arm: Chain::new(&joints, [0.0, -g, 0.0]).expect("axes with a direction"),
        corner: planar.task.config.corner,
        joints: std::array::from_fn(|i| planar.task.config.joints[i.min(1)]),
    };
    let body = |[m, h, i]: [f64; 3]| [m, h, 0.0, 0.0, 0.6 * i, 0.0, i, 0.0, 0.0, i];
    let base = links.map(body);
    let parameters = [base.as_flattened(), &planar.parameters[5..]].concat();
    config.check(&parameters).expect("a possible arm");
    let chain = Case {
        task: Task {
            config,
            clock: planar.task.clock,
            servo: planar.task.servo.clone().map(|servo| match servo {
                Servo::PiVelocity(loops) => Servo::PiVelocity(PiVelocity {
                    kp: padded(loops.kp),
                    ki: padded(loops.ki),
                    limit: loops.limit,
                    period: loops.period,
                    active: padded(loops.active),
                }),
                _ => unreachable!("cases have velocity loops"),
            }),
            record: planar.task.record.clone(),
            link_sensors: link_sensors(2),
        },
        typical: parameters.clone(),
        parameters,
        initial: Initial {
            motor_angle: padded(planar.initial.motor_angle),
            motor_velocity: padded(planar.initial.motor_velocity),
            link_angle: None,
            link_velocity: padded(planar.initial.link_velocity),
            voltage: padded(planar.initial.voltage),
        },
        voltage: planar.voltage.iter().copied().map(padded).collect(),
        reference: planar.reference.iter().copied().map(padded).collect(),
    };
    let width = Width::detect();
    let (of_planar, of_chain) = (planar.directions(), chain.directions());
    let one = planar.differentiate(&of_planar, width);
    let other = chain.differentiate(&of_chain, width);
    // derivative of the planar parameters with respect to each parameter of the chain
    let planar_parts = |k: usize| match k {
        1 => vec![(3, g)],
        9 => vec![(0, 1.0)],
        10 => vec![(0, l * l), (3, g * l)],
        11 => vec![(2, l), (4, g)],
        19 => vec![(1, 1.0)],
        20.. => vec![(k - 15, 1.0)],
        _ => Vec::new(),
    };
    for k in 0..RECORDED.len() {
        let values: Vec<_> = one.values[k].iter().copied().map(padded).collect();
        let values = [values.as_flattened(), other.values[k].as_flattened()];
        let largest = values[0].iter().fold(0.0f64, |a, x| a.max(x.abs()));
        for (one, other) in zip(values[0], values[1]) {
            assert!((one - other).abs() <= 1e-8 * largest, "{:?}", RECORDED[k]);
        }
        for (d, direction) in of_chain.iter().enumerate() {
            let parts = match direction {
                // the planar arm has no first moments across its links
                Source::Parameter(2 | 12) => continue,
                Source::Parameter(k) => planar_parts(*k)
                    .iter()
                    .map(|&(k, factor)| (Source::Parameter(k), factor))
                    .collect(),
                state => vec![(*state, 1.0)],
            };
            let computed = rows_of(&chain, &other.tangents[k], of_chain.len(), d);
            let mut sum = vec![[0.0; 2]; computed.len()];
            for (part, factor) in parts {
                let at = of_planar.iter().position(|&one| one == part).unwrap();
                let rows = rows_of(&planar, &one.tangents[k], of_planar.len(), at);
                for (sum, row) in zip(&mut sum, rows) {
                    *sum = [sum[0] + factor * row[0], sum[1] + factor * row[1]];
                }
            }
            let scale = sum
                .as_flattened()
                .iter()
                .fold(1e-9 * largest, |a, x| a.max(x.abs()));
            let sum: Vec<_> = sum.into_iter().map(padded).collect();
            for (computed, sum) in zip(computed.as_flattened(), sum.as_flattened()) {
                // same tolerance as between two methods, see `check_methods`
                assert!(
                    (computed - sum).abs() <= 1e-6 * scale,
                    "{direction:?} {:?}",
                    RECORDED[k]
                );
            }
        }
    }
}

/// All effects at once.
const ALL: EffectKinds = EffectKinds::ALL;
/// Effects whose torques have no kinks, for which differences are accurate.
const SMOOTH: EffectKinds = EffectKinds {
    load_friction: false,
    backlash: false,
    dead_zone: false,
    ..ALL
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2))]

    #[test]
    fn derivatives_match_differences(seed in any::<u64>(), servo in any::<bool>()) {
        let mut shares = Vec::new();
        let gears = [THREE_SLOPE, LINEAR, RIGID];
        let [one, other] = [seed % 2, seed / 2 % 2].map(|k| gears[k as usize]);
        shares.push(check(&Case::<TwoLink<true>, 2>::random([one, other], seed, servo, 240).level()));
        shares.push(check(&Case::<TwoLink<true>, 2>::random([other, one], seed, servo, 240)));
        shares.push(check(&Case::<TwoLink<true>, 2>::random([one, RIGID], seed, servo, 240)));
        shares.push(check(&Case::<OneLink, 1>::random([one], seed, servo, 240)));
        // Most draws do not change the friction events.
        prop_assert!(shares.iter().sum::<f64>() > 2.0, "{:?}", shares);
    }

    #[test]
    fn derivatives_match_differences_with_effects(seed in any::<u64>(), servo in any::<bool>()) {
        let mut shares = Vec::new();
        let gears = [THREE_SLOPE, LINEAR, RIGID];
        let [one, other] = [seed % 2, seed / 2 % 2].map(|k| gears[k as usize]);
        let some = EffectKinds { hysteresis: seed % 3 == 0, ..SMOOTH };
        shares.push(check(&Case::<TwoLink<true>, 2>::random_with(SMOOTH, [one, other], seed, servo, 240).level()));
        shares.push(check(&Case::<TwoLink<true>, 2>::random_with(SMOOTH, [other, RIGID], seed, servo, 240)));
        shares.push(check(&Case::<TwoLink<true>, 2>::random_with(some, [other, one], seed, servo, 240)));
        shares.push(check(&Case::<OneLink, 1>::random_with(SMOOTH, [one], seed, servo, 240)));
        prop_assert!(shares.iter().sum::<f64>() > 2.0, "{:?}", shares);
    }

    #[test]
    fn derivatives_match_differences_for_chains(seed in any::<u64>(), servo in any::<bool>()) {
        let some = EffectKinds { hysteresis: seed % 3 == 0, ..SMOOTH };
        let shares = [
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random([THREE_SLOPE], seed, servo, 160)),
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(some, [LINEAR, RIGID], seed, servo, 160)),
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR, THREE_SLOPE, LINEAR], seed, servo, 80)),
        ];
        prop_assert!(shares.iter().sum::<f64>() > 1.0, "{:?}", shares);
    }

    #[test]
    fn derivatives_match_differences_for_coupled_chains(seed in any::<u64>(), servo in any::<bool>()) {
        let shares = [
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(SMOOTH, [LINEAR, THREE_SLOPE], seed, servo, 160).coupled()),
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(SMOOTH, [RIGID; 2], seed, servo, 160).coupled()),
            check(&Case::<Chain, MAX_CHAIN_JOINTS>::random([RIGID; 3], seed, servo, 80).coupled()),
        ];
        prop_assert!(shares.iter().sum::<f64>() > 1.0, "{:?}", shares);
    }

    #[test]
    fn methods_agree_for_coupled_chains(seed in any::<u64>(), servo in any::<bool>()) {
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([THREE_SLOPE, LINEAR], seed, servo, 240).coupled());
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR, THREE_SLOPE, LINEAR], seed, servo, 240).coupled());
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(ALL, [LINEAR, THREE_SLOPE], seed, servo, 60).coupled().without_effects());
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(ALL, [LINEAR, THREE_SLOPE, LINEAR], seed, servo, 60).coupled().without_effects());
    }

    #[test]
    fn methods_agree_for_chains(seed in any::<u64>(), servo in any::<bool>()) {
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR], seed, servo, 240));
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([THREE_SLOPE, LINEAR], seed, servo, 240));
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR, THREE_SLOPE, LINEAR], seed, servo, 240));
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR; 6], seed, servo, 80));
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR; 7], seed, servo, 80));
    }

    #[test]
    fn experiments_agree_together_and_alone(seed in any::<u64>()) {
        check_together::<TwoLink<true>, 2>([THREE_SLOPE, LINEAR], seed, 240);
        check_together::<Chain, MAX_CHAIN_JOINTS>([LINEAR, THREE_SLOPE, LINEAR], seed, 160);
        check_together::<Chain, MAX_CHAIN_JOINTS>([LINEAR; 6], seed, 120);
        check_together::<Chain, MAX_CHAIN_JOINTS>([LINEAR, RIGID], seed, 80);
    }

    #[test]
    fn methods_agree_for_linear_laws(seed in any::<u64>()) {
        let two_link = Case::<TwoLink<true>, 2>::random([THREE_SLOPE, LINEAR], seed, true, 400);
        check_methods(&two_link.under_linear_laws());
        let chain = Case::<Chain, MAX_CHAIN_JOINTS>::random([LINEAR, THREE_SLOPE, LINEAR], seed, true, 240);
        check_methods(&chain.under_linear_laws());
    }

    #[test]
    fn planar_chain_agrees_with_closed_form(seed in any::<u64>(), servo in any::<bool>()) {
        check_planar_chain(seed, servo);
    }

    #[test]
    fn methods_and_register_widths_agree(seed in any::<u64>(), servo in any::<bool>()) {
        check_methods(&Case::<TwoLink<true>, 2>::random([THREE_SLOPE, LINEAR], seed, servo, 400).level());
        check_methods(&Case::<TwoLink<true>, 2>::random([LINEAR, THREE_SLOPE], seed, servo, 400));
                for gear in [THREE_SLOPE, LINEAR] {
            check_methods(&Case::<OneLink, 1>::random([gear], seed, servo, 400));
        }
    }

    #[test]
    fn variants_agree_with_experiments_of_their_own(seed in any::<u64>(), servo in any::<bool>()) {
        check_variants(&Case::<TwoLink<true>, 2>::random_with(ALL, [THREE_SLOPE, LINEAR], seed, servo, 240).without_effects());
        check_variants(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(ALL, [LINEAR; 3], seed, servo, 60).without_effects());
        check_variants(&Case::<OneLink, 1>::random_with(ALL, [LINEAR], seed, servo, 240).without_effects());
    }

    #[test]
    fn methods_agree_for_drive_effects(seed in any::<u64>(), servo in any::<bool>()) {
        check_methods(&Case::<TwoLink<true>, 2>::random_with(ALL, [THREE_SLOPE, LINEAR], seed, servo, 400).level().with_drive_effects_only());
        check_methods(&Case::<OneLink, 1>::random_with(ALL, [LINEAR], seed, servo, 400).with_drive_effects_only());
    }

    #[test]
    fn methods_agree_for_zero_size_effects(seed in any::<u64>(), servo in any::<bool>()) {
        let some = EffectKinds { hysteresis: seed % 3 == 0, stribeck: seed % 3 == 1, ..ALL };
        check_methods(&Case::<TwoLink<true>, 2>::random_with(ALL, [THREE_SLOPE, LINEAR], seed, servo, 400).level().without_effects());
        check_methods(&Case::<TwoLink<true>, 2>::random_with(some, [LINEAR, THREE_SLOPE], seed, servo, 400).without_effects());
        check_methods(&Case::<OneLink, 1>::random_with(ALL, [THREE_SLOPE], seed, servo, 400).without_effects());
        check_methods(&Case::<Chain, MAX_CHAIN_JOINTS>::random_with(ALL, [THREE_SLOPE, LINEAR], seed, servo, 80).without_effects());
    }
}
