//! A gear law defined outside the core crate, as a user would add one. Simulation and derivatives
//! work without changes to the crate.

use std::iter::zip;

use crate::common::config;
use strainwave_core::arm::OneLink;
use strainwave_core::experiment::{Clock, Initial, Member, Quantity, Source, Task};
use strainwave_core::joint::gear::{GearLaw, Law, MAX_LAW_PARAMETERS, SingleLaw, Spring};
use strainwave_core::parameter::{Parameter, STIFFNESS};
use strainwave_core::plant::config::Config;
use strainwave_core::program::{dual_numbers, forward, simulate};
use strainwave_core::scalar::Real;
use strainwave_core::sensitivity::Request;

/// T = k delta (1 + c |delta|).
#[derive(Clone, Copy)]
struct Quadratic;

#[derive(Clone, Copy)]
struct QuadraticSpring<R> {
    k: R,
    c: R,
}

impl GearLaw for Quadratic {
    const LAW: Law = Law {
        name: "quadratic",
        parameters: &[
            Parameter::positive("slope", "k", STIFFNESS).meaning("stiffness at rest"),
            Parameter::non_negative("rise", "c", ["1/rad", "1/m"]).meaning("rise"),
        ],
        rising: &[],
        elastic: true,
    };
    type Spring<R: Real> = QuadraticSpring<R>;

    fn spring<R: Real>(values: &[R; MAX_LAW_PARAMETERS], _: f64) -> QuadraticSpring<R> {
        let [k, c] = [values[0], values[1]];
        QuadraticSpring { k, c }
    }
}

impl<R: Real> Spring<R> for QuadraticSpring<R> {
    type Shared = ();

    fn torque(&self, delta: R) -> R {
        self.k * delta * (R::splat(1.0) + self.c * delta.abs())
    }

    fn stiffness(&self, delta: R) -> R {
        self.k * (R::splat(1.0) + R::splat(2.0) * self.c * delta.abs())
    }

    fn energy(&self, delta: R) -> R {
        let third = R::splat(2.0 / 3.0) * self.c * delta.abs();
        R::splat(0.5) * self.k * delta * delta * (R::splat(1.0) + third)
    }

    fn least_stiffness(&self, _: R) -> R {
        self.k
    }

    fn shared(&self) {}

    fn by_parameters(&self, delta: R, (): &()) -> [R; MAX_LAW_PARAMETERS] {
        let mut by = [R::splat(0.0); MAX_LAW_PARAMETERS];
        by[0] = self.torque(delta) / self.k;
        by[1] = self.k * delta * delta.abs();
        by
    }
}

/// Integrator step [s].
const STEP: f64 = 2e-5;
/// link_inertia, gravity torque; motor; k, c, damping, settling time.
const PARAMETERS: [f64; 11] = [0.2, 0.0, 1e-4, 0.0, 0.0, 0.0, 0.0, 9e3, 400.0, 0.0, 0.0];

fn task() -> Task<OneLink, 1> {
    Task {
        config: config([Quadratic::LAW]),
        clock: Clock {
            step: STEP,
            steps_per_tick: 1,
            steps_per_servo: 1,
            steps_per_sample: 1,
            samples: 4001,
        },
        servo: None,
        record: vec![
            Quantity::MotorAngle,
            Quantity::MotorVelocity,
            Quantity::LinkAngle,
            Quantity::LinkVelocity,
        ],
        link_sensors: Vec::new(),
    }
}

/// Release of a gear with initial torsion.
fn member<'a>(parameters: &'a [f64], zeros: &'a [[f64; 1]]) -> Member<'a, 1> {
    Member {
        parameters,
        feed_forward: zeros,
        reference: zeros,
        initial: Initial {
            motor_angle: [0.3],
            motor_velocity: [0.0],
            link_angle: Some([0.0]),
            link_velocity: [0.0],
            voltage: [0.0],
        },
    }
}

#[test]
fn external_law_conserves_energy() {
    let (task, zeros) = (task(), vec![[0.0]; 4001]);
    let member = member(&PARAMETERS, &zeros);
    let record = simulate::<_, SingleLaw<Quadratic>, 1, false>(&task, &member).expect("finite");
    let spring = Quadratic::spring(&[9e3, 400.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.0);
    let energy = |k: usize| {
        let [motor, speed, link, rate] = [0, 1, 2, 3].map(|quantity| record[quantity][k][0]);
        let kinetic = 0.5 * (1e-4 * speed * speed + 0.2 * rate * rate);
        kinetic + spring.energy(0.01 * motor - link)
    };
    let begin = energy(0);
    let rate = |k: usize| record[3][k][0];
    assert!(
        (0..4001).any(|k| rate(k) > 0.1) && (0..4001).any(|k| rate(k) < -0.01 || rate(k) == 0.0)
    );
    for k in 0..4001 {
        assert!(
            (energy(k) / begin - 1.0).abs() < 1e-6,
            "{k}: {}",
            energy(k) / begin
        );
    }
}

#[test]
fn external_law_derivatives_match_differences() {
    let (task, zeros) = (task(), vec![[0.0]; 4001]);
    let member = member(&PARAMETERS, &zeros);
    let directions = [0, 2, 7, 8, 9].map(Source::Parameter);
    let request = Request {
        task: &task,
        member: &member,
        directions: &directions,
        variants: &[],
        decimation: None,
    };
    let fast = forward::<_, SingleLaw<Quadratic>, 1, false>(&request).expect("finite");
    let slow = dual_numbers::<_, SingleLaw<Quadratic>, 1, false>(&request).expect("finite");
    for (fast, slow) in zip(&fast.tangents, &slow.tangents) {
        for d in 0..directions.len() {
            let most = slow.iter().skip(d).step_by(directions.len());
            let most = most.fold(0.0f64, |most, one| most.max(one.abs()));
            for (one, other) in zip(&fast[d..], &slow[d..]).step_by(directions.len()) {
                assert!((one - other).abs() <= 1e-8 * most, "{d}: {one} {other}");
            }
        }
    }
}

#[test]
fn external_law_parameters_are_checked_and_named() {
    let config: Config<OneLink, 1> = config([Quadratic::LAW]);
    let names: Vec<&str> = config.parameter_names().iter().map(|name| name.0).collect();
    assert_eq!(
        names[7..],
        ["slope", "rise", "gear_damping", "friction_settling_time"]
    );
    let mut values = PARAMETERS;
    values[8] = -1.0;
    let error = config.check(&values).unwrap_err().to_string();
    assert_eq!(error, "rise of joint 1 is -1, but must be zero or positive");
}
