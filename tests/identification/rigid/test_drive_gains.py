"""Unknown torques per volt from motions with and without a known payload."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    Control,
    Experiment,
    FloatArray,
    Joint,
    Origin,
    Payload,
    Servo,
    Signals,
    Study,
)
from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.description import UNKNOWN
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise, record_inputs
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import rigid
from strainwave.io.study import write_study
from strainwave.virtual.experiments import simulate_study
from virtual_arms import exact_motion, exact_signals

GAINS = (0.18, 0.15, 0.07)
PAYLOAD = Payload(3.0, (0.25, 0.03, 0.05))
# mass, first moments and inertias of each link, as in URDF
BODY = (3.0, 0.45, 0.03, 0.06, 0.02, -0.005, 0.12, -0.009, 0.0, 0.11)
FRICTION = (3e-4, 0.03, 0.002)  # viscous, Coulomb, offset of each motor


def chain(spring: str = "rigid", unknown: tuple[int, ...] = (1, 2, 3)) -> Arm:
    """A vertical axis and two parallel horizontal axes under gravity."""
    turned = (0.5 * np.pi, 0.0, 0.0)
    origins = (Origin(), Origin((0.05, 0.0, 0.3), turned), Origin((0.3, 0.0, 0.0)))
    joints = tuple(
        Joint(spring, 0.01, torque_per_volt=gain, encoder_counts=8192, origin=origin)
        for gain, origin in zip(GAINS, origins, strict=True)
    )
    arm = ArmDescription("serial", joints, (0.0, 0.0, -9.81), servo=SERVO)
    for number in unknown:
        arm = arm.with_joint(number, torque_per_volt=UNKNOWN)
    return Arm.of(arm)


SERVO = Servo("pi-velocity", 1e-3, (0.1, 0.1, 0.05), (0.8, 0.8, 0.4), 10.0, (5.0, 5.0, 5.0))


def values_of(arm: Arm) -> Values:
    """Parameters of the chain."""
    known: Values = {}
    for number in (1, 2, 3):
        keys = [key for key in arm.base_names if key[1] == number]
        known |= dict(zip(keys, BODY, strict=True))
        known["motor_inertia", number] = 2e-4
        known["motor_viscous_friction", number] = FRICTION[0]
        known["motor_coulomb_friction", number] = FRICTION[1]
        known["friction_offset", number] = FRICTION[2]
        known["link_viscous_friction", number] = 0.0
        known["gear_stiffness", number] = 3e4
        known["gear_damping", number] = 10.0
    return known


def signals_of(arm: Arm, payload: Payload | None, seed: int) -> Signals:
    """Exact signals of a record; torques of unknown drives are in volts."""
    motion = exact_motion(3, seed)
    loaded = record_inputs(arm, values_of(arm), "r", hanging=True, payload=payload).values
    links = [arm.links_of(x) for x in motion[1:]]
    torque = arm.inverse_dynamics(arm.parameter_vector(loaded), *links)
    gains = np.where([j.torque_per_volt == UNKNOWN for j in arm.joints], GAINS, 1.0)
    signals = exact_signals(motion, torque / gains)
    return replace(signals, experiment=replace(signals.experiment, payload=payload))


def test_a_point_mass_has_the_torques_of_its_weight_and_inertia() -> None:
    """The payload's torque is the difference of both arms, (S2)."""
    arm = chain()
    bare, loaded = (signals_of(chain(unknown=()), p, 1).motor_torque for p in (None, PAYLOAD))
    motion = [arm.links_of(x) for x in exact_motion(3, 1)[1:]]
    expected: FloatArray = loaded - bare
    np.testing.assert_allclose(arm.payload_torques(PAYLOAD, *motion), expected, atol=1e-10)


@pytest.mark.parametrize("unknown", [(1, 2, 3), (2,)])
def test_exact_records_give_the_gains(unknown: tuple[int, ...]) -> None:
    arm = chain(unknown=unknown)
    gains = rigid.estimate_drive_gains([signals_of(arm, p, 1) for p in (None, PAYLOAD)], arm)
    assert [p.joint for p in gains.parameters] == list(unknown)
    for parameter in gains.parameters:
        assert parameter.value == pytest.approx(GAINS[(parameter.joint or 1) - 1], rel=1e-5)
    assert {w.code for w in gains.warnings} == {"estimated-drive"}


def test_records_without_difference_do_not_give_the_gains() -> None:
    arm = chain()
    with pytest.raises(NotIdentifiable, match="do not determine torque_per_volt of joint"):
        rigid.estimate_drive_gains([signals_of(arm, None, seed) for seed in (1, 2)], arm)


def study_of(arm: Arm, folder: Path) -> Study:
    servo: tuple[Control, ...] = ("servo",) * 3
    records = (
        Experiment("motion", "motion.csv", "motion", servo),
        Experiment("loaded", "loaded.csv", "motion", servo, payload=PAYLOAD),
        Experiment("check", "check.csv", "check", servo, payload=PAYLOAD),
    )
    return Study(arm=arm, experiments=records, path=folder / "study.toml")


def test_a_simulation_needs_the_gains(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="torque_per_volt of joint 1 is unknown"):
        simulate_study(study_of(chain(), tmp_path), values_of(chain()), tmp_path)


def test_gains_of_a_simulated_chain_lie_in_their_intervals(tmp_path: Path) -> None:
    known = study_of(chain("linear", unknown=()), tmp_path)
    simulate_study(known, values_of(chain()), tmp_path, noise=SensorNoise(), as_recorded=False)
    write_study(study_of(chain("linear"), tmp_path), tmp_path / "study.toml")
    result = pipeline.identify(tmp_path / "study.toml", stages=("rigid",))
    assert result.verdict.exit_code == 0, result.reason
    for parameter, gain in zip(result.drive_gains, GAINS, strict=True):
        assert parameter.std is not None
        assert parameter.value == pytest.approx(gain, rel=0.01)
        assert parameter.value == pytest.approx(gain, abs=4.0 * parameter.std)
        assert parameter in result.parameters
    # later stages have the estimates
    assert result.study.arm.unknown_drives == ()
    (check,) = result.checks
    assert min(check.fit_percent.values()) > 95.0
    assert result.rigid is not None
    columns = base_parameters(known.arm).columns
    truth = values_of(chain())
    for parameter, column in zip(result.rigid.parameters, columns, strict=False):
        # the largest base parameters are 1 kg m and 1 kg m^2; motor inertias have the scale n^2
        size = 1e-4 if column.name == "motor_inertia" else 1.0
        expected = value_of(column.parts, truth)
        assert parameter.value == pytest.approx(expected, abs=0.01 * size), column
