//! Motions with a solution in closed form.

use crate::common::{LINEAR, RIGID, Run, at_rest, level_joint};
use strainwave_core::experiment::{Initial, Quantity};

/// Gear ratio.
const N: f64 = 0.01;

/// link inertia, G1, motor inertia, d_M, f_M, f_0, d_L, gear stiffness, gear damping, settling time
fn one_joint(link: f64, motor: f64, coulomb: f64, stiffness: f64) -> Vec<f64> {
    vec![
        link, 0.0, motor, 0.0, coulomb, 0.0, 0.0, stiffness, 0.0, 0.0,
    ]
}

#[test]
fn two_inertias_oscillate_at_their_mode() {
    let (link, motor, k) = (2.0, 1.5e-4, 20e3);
    let parameters = one_joint(link, motor, 0.0, k);
    let torsion = 1e-3;
    let run = Run {
        config: level_joint(LINEAR),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: Initial {
            link_angle: Some([-torsion]),
            ..at_rest([0.0])
        },
        step: 1.25e-4,
        steps: 8000,
    };
    let record = run.record(&[Quantity::MotorAngle, Quantity::LinkAngle]);
    let omega = (k * (1.0 / link + N * N / motor)).sqrt();
    for step in 0..=run.steps {
        let t = step as f64 * run.step;
        let delta = N * record[0][step][0] - record[1][step][0];
        // Phase error of Runge-Kutta per step: (omega h)^5 / 120 = 5e-11 rad, over 8000 steps.
        assert!((delta - torsion * (omega * t).cos()).abs() < 1e-6 * torsion);
    }
}

#[test]
fn rigid_joint_follows_lagged_torque() {
    let mut config = level_joint(RIGID);
    config.joints[0].current_loop_hz = Some(200.0);
    let (link, motor) = (0.8, 1.5e-4);
    let parameters = [link, 0.0, motor, 0.0, 0.0, 0.0, 0.0];
    let run = Run {
        config,
        parameters: &parameters,
        voltage: &[[5.0]],
        steps_per_tick: 1,
        initial: at_rest([0.0]),
        step: 1.25e-4,
        steps: 800,
    };
    let velocity = &run.record(&[Quantity::MotorVelocity])[0];
    let lag = 1.0 / (std::f64::consts::TAU * 200.0);
    let acceleration = 0.1 * 5.0 / (motor + N * N * link);
    for step in 0..=run.steps {
        let t = step as f64 * run.step;
        let exact = acceleration * (t - lag * (1.0 - (-t / lag).exp()));
        // Simpson's rule for an exponential: error (h / lag)^4 / 2880 of the transient.
        assert!((velocity[step][0] - exact).abs() < 1e-6 * acceleration * lag + 1e-12);
    }
}

/// Free oscillation of a motor on its gear with Coulomb friction; the inertia of the link is very
/// large. The amplitude decreases by 2 f / k in each half period. The motion ends where the spring
/// torque is below the friction limit.
#[test]
fn dry_friction_stops_oscillation_in_the_dead_band() {
    let (motor, k, f) = (1.5e-4, 20e3, 0.06);
    let parameters = one_joint(1e12, motor, f, k);
    let band = f / (N * N * k); // [rad] motor side: friction torque over spring stiffness
    let begin = 10.5 * band;
    let run = Run {
        config: level_joint(LINEAR),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: Initial {
            link_angle: Some([0.0]),
            ..at_rest([begin])
        },
        step: 1.25e-4,
        steps: 2000,
    };
    let record = run.record(&[Quantity::MotorAngle, Quantity::MotorVelocity]);
    let omega = (N * N * k / motor).sqrt();
    for step in 0..=run.steps {
        let t = step as f64 * run.step;
        let swing = (omega * t / std::f64::consts::PI).floor();
        let side = if swing % 2.0 == 0.0 { 1.0 } else { -1.0 };
        let exact = if swing < 5.0 {
            let phase = omega * t - swing * std::f64::consts::PI;
            side * (band + (begin - (2.0 * swing + 1.0) * band) * phase.cos())
        } else {
            -0.5 * band
        };
        let actual = record[0][step][0];
        assert!(
            (actual - exact).abs() < 1e-7 * begin,
            "{actual} {exact} at {t}"
        );
        if swing >= 5.0 {
            assert_eq!(record[1][step][0], 0.0);
        }
    }
}

/// A link that moves at constant velocity: its motor sticks until the spring torque reaches the
/// friction limit, then follows with v (1 - cos).
#[test]
fn motor_breaks_away_when_spring_torque_reaches_friction() {
    let (motor, k, f, pull) = (1.5e-4, 20e3, 0.06, 0.05);
    let parameters = one_joint(1e12, motor, f, k);
    let run = Run {
        config: level_joint(LINEAR),
        parameters: &parameters,
        voltage: &[[0.0]],
        steps_per_tick: 1,
        initial: Initial {
            link_angle: Some([0.0]),
            link_velocity: [pull],
            ..at_rest([0.0])
        },
        step: 1.25e-4,
        steps: 1200,
    };
    let velocity = &run.record(&[Quantity::MotorVelocity])[0];
    let omega = (N * N * k / motor).sqrt();
    let release = f / (N * k * pull);
    let again = release + std::f64::consts::TAU / omega; // the velocity touches zero
    for step in 0..=run.steps {
        let t = step as f64 * run.step;
        if t < release {
            assert_eq!(velocity[step][0], 0.0);
        } else if t < again - run.step {
            let exact = pull / N * (1.0 - (omega * (t - release)).cos());
            assert!((velocity[step][0] - exact).abs() < 1e-7 * pull / N);
        }
        assert!(velocity[step][0] > -1e-6);
    }
}

#[test]
fn torque_ramp_releases_motor_at_analytic_time() {
    // The voltage rises by 1 mV per step; friction of 0.06 N m breaks away at 0.6 V.
    let parameters = [0.0, 0.0, 1.5e-4, 0.0, 0.06, 0.0, 0.0];
    let voltage: Vec<[f64; 1]> = (0..2000).map(|k| [1e-3 * f64::from(k)]).collect();
    let run = Run {
        config: level_joint(RIGID),
        parameters: &parameters,
        voltage: &voltage,
        steps_per_tick: 1,
        initial: at_rest([0.0]),
        step: 1.25e-4,
        steps: 700,
    };
    let velocity = &run.record(&[Quantity::MotorVelocity])[0];
    for step in 0..=600 {
        assert_eq!(velocity[step][0], 0.0);
    }
    assert!(velocity[602][0] > 0.0);
}
