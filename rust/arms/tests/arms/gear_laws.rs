//! Gear laws: torque against energy, derivatives, inverse, and whole experiments.

use std::iter::zip;

use crate::common::{Draw, clock, config, differentiate_over_dual_numbers, sensitivities};
use proptest::prelude::*;
use strainwave_core::arm::TwoLink;
use strainwave_core::experiment::{Initial, Member, Quantity, Source, Task};
use strainwave_core::joint::gear::{
    self, AllLaws, AnySpring, CORNER, Gears, Law, MAX_LAW_PARAMETERS, Spring,
};
use strainwave_core::program::Width;
use strainwave_core::scalar::{Dual, Real};

type Number = Dual<f64, f64>;

fn elastic() -> impl Iterator<Item = Law> {
    gear::all_laws().into_iter().filter(|law| law.elastic)
}

/// Typical values of a size 20 gear, varied by some tens of percent.
fn random_values(law: &Law, draw: &mut Draw) -> [f64; MAX_LAW_PARAMETERS] {
    let mut values = [0.0; MAX_LAW_PARAMETERS];
    for (value, parameter) in zip(&mut values, law.parameters) {
        let typical = match (parameter.units[0], parameter.name) {
            ("N m/rad", _) => 16e3,
            ("N m/rad^3", _) => 5e9,
            (_, "gear_knee_t2") => 25.0,
            ("N m", _) => 7.0,
            (unit, name) => panic!("no usual value of {name} [{unit}]: add one here"),
        };
        *value = typical * (1.0 + 0.4 * draw.next());
    }
    values
}

fn spring<R: Real>(law: &Law, values: &[R; MAX_LAW_PARAMETERS]) -> AnySpring<R> {
    AllLaws::spring(law, values, CORNER)
}

fn seeded(value: f64) -> Number {
    Dual {
        value,
        tangent: 1.0,
    }
}

fn close(one: f64, other: f64, scale: f64) -> Result<(), TestCaseError> {
    prop_assert!((one - other).abs() <= 1e-12 * scale, "{one} {other}");
    Ok(())
}

proptest! {
    #[test]
    fn torque_is_odd_and_derivative_of_energy(seed: u64, delta in -3e-3..3e-3f64) {
        for law in elastic() {
            let values = random_values(&law, &mut Draw::new(seed));
            let (spring_of_law, dual) = (spring(&law, &values), spring(&law, &values.map(Number::constant)));
            let torque = spring_of_law.torque(delta);
            prop_assert_eq!(spring_of_law.torque(-delta), -torque);
            prop_assert_eq!(spring_of_law.torque(0.0), 0.0);
            close(torque, dual.energy(seeded(delta)).tangent, 100.0)?;
        }
    }

    #[test]
    fn derivatives_match_those_of_the_torque(seed: u64, delta in -3e-3..3e-3f64) {
        for law in elastic() {
            let values = random_values(&law, &mut Draw::new(seed));
            let spring_of_law = spring(&law, &values);
            let by_delta = spring(&law, &values.map(Number::constant)).torque(seeded(delta));
            close(spring_of_law.stiffness(delta), by_delta.tangent, 1e5)?;
            let actual = spring_of_law.by_parameters(delta, &spring_of_law.shared());
            for k in 0..MAX_LAW_PARAMETERS {
                let mut dual = values.map(Number::constant);
                if k < law.parameters.len() {
                    dual[k] = seeded(values[k]);
                }
                let by_one = spring(&law, &dual).torque(Number::constant(delta)).tangent;
                close(actual[k] * values[k], by_one * values[k], 100.0)?;
            }
        }
    }

    #[test]
    fn torsion_inverts_torque(seed: u64, torque in -80.0..80.0f64) {
        for law in elastic() {
            let spring_of_law = spring(&law, &random_values(&law, &mut Draw::new(seed)));
            let torsion = spring_of_law.torsion(torque);
            prop_assert!((spring_of_law.torque(torsion) - torque).abs() < 1e-12 * (1.0 + torque.abs()));
            prop_assert!(spring_of_law.least_stiffness(torque) * torsion.abs() <= torque.abs() * (1.0 + 1e-12));
        }
    }
}

/// An arm with every pair of gear laws, including rigid gears: derivatives by the variational
/// equations, where available, against dual numbers.
#[test]
fn derivatives_match_differences_for_every_pair_of_laws() {
    for first in gear::all_laws() {
        for second in gear::all_laws() {
            let config = config::<TwoLink<true>, 2>([first, second]);
            let mut draw = Draw::new(7);
            let laws = [first, second].map(|law| (law, random_values(&law, &mut draw)));
            let mut parameters = vec![1.6, 0.65, 0.5, 31.0, 7.4];
            for (law, values) in laws {
                parameters.extend([1e-4, 2e-4, 0.05, 0.0, 0.3]);
                if law.elastic {
                    parameters.extend(&values[..law.parameters.len()]);
                    parameters.extend([10.0, 0.0]);
                }
            }
            config.check(&parameters).expect("a possible arm");
            let names = config.parameter_names();
            let directions: Vec<Source> = (0..names.len())
                .filter(|&k| names[k].0 != "friction_settling_time")
                .map(Source::Parameter)
                .collect();
            let task = Task {
                config,
                clock: clock(60),
                servo: None,
                record: vec![Quantity::MotorVelocity, Quantity::LinkAcceleration],
                link_sensors: Vec::new(),
            };
            let volts: Vec<[f64; 2]> = (0..60)
                .map(|_| [8.0, 5.0].map(|size| size * draw.next().signum()))
                .collect();
            let member = Member {
                parameters: &parameters,
                feed_forward: &volts,
                reference: &volts,
                initial: Initial {
                    motor_angle: [20.0, -10.0],
                    motor_velocity: [5.0, -5.0],
                    link_angle: None,
                    link_velocity: [0.05, -0.05],
                    voltage: [0.0; 2],
                },
            };
            for width in [Width::Portable, Width::detect()] {
                let fast = sensitivities(&task, &member, &directions, width).expect("finite");
                let slow =
                    differentiate_over_dual_numbers(&task, &member, &directions).expect("finite");
                if width == Width::detect() {
                    assert_eq!(fast.values, slow.values);
                }
                for (fast, slow) in zip(&fast.tangents, &slow.tangents) {
                    for d in 0..directions.len() {
                        let column = |all: &[f64]| -> Vec<f64> {
                            all.iter()
                                .skip(d)
                                .step_by(directions.len())
                                .copied()
                                .collect()
                        };
                        let (fast, slow) = (column(fast), column(slow));
                        let scale = slow
                            .iter()
                            .fold(0.0f64, |largest, one| largest.max(one.abs()));
                        for (one, other) in zip(fast, slow) {
                            assert!(
                                (one - other).abs() <= 1e-7 * scale,
                                "{:?} of {} and {}: {one} {other}",
                                names[d],
                                first.name,
                                second.name,
                            );
                        }
                    }
                }
            }
        }
    }
}
