"""Terms, corrections and bounds of a rigid joint, on a pendulum integrated here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import cos, tanh
from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from strainwave.domain import FloatArray, RigidModel
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification.rigid import fit_rigid
from strainwave.io.logs import read_logs
from strainwave.signals.motor import prepare_motor_signals

SAMPLE_TIME, SUBSTEPS = 1e-3, 10
SAMPLES, LEAD = 20_000, 100  # of a log, and before it
# the torque of a sample is held until the next one, and so acts half a period later on average
HALF_HOLD = 0.5 * SAMPLE_TIME


@dataclass(frozen=True)
class Pendulum:
    """J ddq + d dq + f sgn dq + G cos q + k q = torque."""

    inertia: float = 0.5
    viscous: float = 0.8
    coulomb: float = 1.2
    gravity: float = 6.0
    stiffness: float = 0.0

    def log(
        self, centre: float = 0.0, zero: float = 0.0, delay: float = 0.0, seed: int = 0
    ) -> dict[str, FloatArray]:
        """A multisine under a PD servo; the angle reads q - zero, the torque `delay` late."""
        rng = np.random.default_rng(seed)
        phases = tuple(rng.uniform(0.0, 2.0 * np.pi, 3).tolist())
        angle, torque = _motion(self, centre, phases)
        time = np.arange(len(angle)) * SAMPLE_TIME
        late = np.interp(time - delay, time, torque)
        return {
            "t": time[:SAMPLES],
            "theta_m1": angle[LEAD:] - zero + rng.normal(0.0, 2e-5, SAMPLES),
            "torque1": late[LEAD:] + rng.normal(0.0, 0.02, SAMPLES),
        }


@cache
def _motion(
    pendulum: Pendulum, centre: float, phases: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Angle and torque without noise; plain floats, which are several times faster here."""
    frequency = 2.0 * np.pi * np.array([0.3, 0.7, 1.3])
    amplitude = np.array([0.8, 0.4, 0.2])
    turns = np.outer(np.arange(SAMPLES + LEAD) * SAMPLE_TIME, frequency) + np.array(phases)
    positions = (centre + np.sin(turns) @ amplitude).tolist()
    rates = (np.cos(turns) @ (amplitude * frequency)).tolist()
    inertia, viscous, coulomb = pendulum.inertia, pendulum.viscous, pendulum.coulomb
    gravity, stiffness = pendulum.gravity, pendulum.stiffness
    angle, torque = list[float](), list[float]()
    q, v, step = centre, 0.0, SAMPLE_TIME / SUBSTEPS
    for position, rate in zip(positions, rates, strict=True):
        held = 120.0 * (position - q) + 12.0 * (rate - v) + gravity * cos(q)
        angle.append(q)
        torque.append(held)
        for _ in range(SUBSTEPS):
            friction = viscous * v + coulomb * tanh(v / 1e-3)
            middle = q + 0.5 * step * v
            load = gravity * cos(middle) + stiffness * middle
            change = step * (held - friction - load) / inertia
            q += step * (v + 0.5 * change)
            v += change
    return np.array(angle), np.array(torque)


def study_of(folder: Path, *, gravity: bool = True, joint: str = "") -> sw.Study:
    path = folder / "study.toml"
    path.write_text(
        '[arm]\nkind = "single-joint"\n'
        + ("gravity = 9.81\n" if gravity else "")
        + f'[[joint]]\nspring = "rigid"\ngear_ratio = 1.0\n{joint}\n'
        + '[[experiment]]\nname = "m"\nfile = "m.csv"\nuse = "motion"\ncontrol = ["open"]\n'
    )
    return sw.read_study(path)


def model_of(study: sw.Study, log: Mapping[str, FloatArray], *options: str) -> RigidModel:
    run = sw.identify(study, data={"m": log}, options=options or None).run
    assert run is not None
    assert run.rigid is not None
    return run.rigid


def check(model: RigidModel, pendulum: Pendulum) -> None:
    """The values are those of the pendulum, but for 0.1 % from the change of friction at rest."""
    truth = {
        "inertia": pendulum.inertia,
        "motor_viscous_friction": pendulum.viscous,
        "motor_coulomb_friction": pendulum.coulomb,
        "gravity_torque_1": pendulum.gravity,
    }
    for p in model.parameters:
        if p.name in truth:
            assert p.value == pytest.approx(truth[p.name], rel=0.003), p


def size_of(model: RigidModel, effect: str) -> float:
    (size,) = (term.size.value for term in model.friction_terms if term.effect == effect)
    assert size is not None
    return size


@pytest.mark.parametrize("gravity", [0.0, 6.0])
def test_a_parallel_spring_does_not_bias_the_inertia(tmp_path: Path, gravity: float) -> None:
    pendulum = Pendulum(gravity=gravity, stiffness=3.0)
    model = model_of(study_of(tmp_path, gravity=gravity > 0.0), pendulum.log())
    check(model, pendulum)
    assert size_of(model, "ground-spring") == pytest.approx(3.0, rel=0.005)


def test_the_zero_is_estimated_where_gravity_acts(tmp_path: Path) -> None:
    model = model_of(study_of(tmp_path), Pendulum().log(zero=0.3))
    check(model, Pendulum())
    assert size_of(model, "encoder-zero") == pytest.approx(0.3, abs=1e-3)
    assert any("exceeds the encoder reading" in w.message for w in model.warnings)


@pytest.mark.parametrize("zero", [0.5 * np.pi, -0.5 * np.pi, -1.0])
def test_a_distant_zero_is_no_spring(tmp_path: Path, zero: float) -> None:
    study = study_of(tmp_path)
    arm = Arm.of(study.arm)
    (log,) = read_logs(study, data={"m": Pendulum().log(centre=-0.5 * np.pi, zero=zero)})
    model = fit_rigid([prepare_motor_signals(log, arm)], arm)
    check(model, Pendulum())
    assert size_of(model, "encoder-zero") == pytest.approx(zero, abs=1e-3)


@pytest.mark.parametrize("gravity", [0.0, 6.0])
def test_a_late_torque_is_corrected(tmp_path: Path, gravity: float) -> None:
    pendulum = Pendulum(gravity=gravity)
    model = model_of(study_of(tmp_path, gravity=gravity > 0.0), pendulum.log(delay=0.02))
    check(model, pendulum)
    assert size_of(model, "torque-delay") == pytest.approx(0.02 - HALF_HOLD, abs=1e-4)


def test_without_effects_the_delay_biases_the_friction(tmp_path: Path) -> None:
    study = study_of(tmp_path, joint="effects = []")
    model = model_of(study, Pendulum().log(delay=0.02), "accept=misaligned")
    assert model.friction_terms == ()
    assert model.value("motor_viscous_friction", 1) != pytest.approx(0.8, rel=0.05)


def test_a_named_effect_is_part_of_the_model(tmp_path: Path) -> None:
    study = study_of(tmp_path, joint='effects = ["stribeck", "torque-delay"]')
    model = model_of(study, Pendulum().log())
    assert {term.effect for term in model.friction_terms} == {"stribeck", "torque-delay"}


@pytest.mark.parametrize(
    ("effects", "gravity", "problem"),
    [
        ("torque-ripple", True, "is part of the whole-arm fit"),
        ("encoder-zero", False, "needs gravity"),
        ("backlash", True, "needs an elastic gear"),
        ("gear-torsion", True, "needs the torque of a sensor behind the gear"),
    ],
)
def test_an_effect_that_cannot_be_used_is_refused(
    tmp_path: Path, effects: str, *, gravity: bool, problem: str
) -> None:
    with pytest.raises(InvalidInput, match=problem):
        sw.identify(
            study_of(tmp_path, gravity=gravity, joint=f'effects = ["{effects}"]'),
            data={"m": Pendulum().log()},
        )


def test_a_friction_of_nothing_is_at_its_bound(tmp_path: Path) -> None:
    pendulum = Pendulum(viscous=0.0)
    at_zero = 0
    for seed in range(4):
        model = model_of(study_of(tmp_path), pendulum.log(seed=seed))
        (p,) = (p for p in model.parameters if p.name == "motor_viscous_friction")
        assert p.value is not None
        assert p.ci95 is not None
        assert p.value >= 0.0
        at_zero += p.value == 0.0
        if p.value == 0.0:
            assert p.ci95[0] == 0.0 < p.ci95[1] < 0.05
    assert at_zero > 0


def test_a_sensor_behind_the_gear_shows_the_link(tmp_path: Path) -> None:
    """The sensor's torque is without rotor inertia and friction: neither is asked for."""
    log = Pendulum(viscous=0.0, coulomb=0.0).log()
    log["tau_l1"] = log.pop("torque1")
    result = sw.identify(study_of(tmp_path), data={"m": log})
    assert result.status == "determined"
    assert result["link_inertia", 1].value == pytest.approx(0.5, rel=0.01)
    assert result.run is not None
    assert "torque-at-link" in {w.code for w in result.run.warnings}


def test_a_sensor_behind_an_elastic_gear_shows_link_and_stiffness(tmp_path: Path) -> None:
    """The motor leads the link by the torsion; both have encoders."""
    log = Pendulum(viscous=0.0, coulomb=0.0).log()
    log["theta_l1"], log["tau_l1"] = log["theta_m1"], log.pop("torque1")
    log["theta_m1"] = log["theta_l1"] + log["tau_l1"] / 800.0
    study = study_of(tmp_path)
    text = study.path.read_text().replace('spring = "rigid"', 'spring = "linear"')
    study.path.write_text(text)
    study = sw.read_study(study.path)
    result = sw.identify(study, data={"m": log})
    assert result["link_inertia", 1].value == pytest.approx(0.5, rel=0.01)
    assert result["gear_stiffness", 1].value == pytest.approx(800.0, rel=0.01)
    steps = replace(study, experiments=(replace(study.experiments[0], use="tuning"),))
    with pytest.raises(InvalidInput, match="no motor input"):
        sw.identify(steps, data={"m": log})


def test_a_sensor_behind_a_gear_called_rigid_shows_its_torsion(tmp_path: Path) -> None:
    """The anti-resonance is at 4 Hz, three times the highest frequency of the motion."""
    log = Pendulum(viscous=0.3, coulomb=0.0).log()
    log["tau_l1"] = log.pop("torque1")
    log["theta_m1"] = log["theta_m1"] + log["tau_l1"] / 300.0
    model = model_of(study_of(tmp_path), log)
    assert size_of(model, "gear-torsion") == pytest.approx(1.0 / 300.0, rel=0.05)
    result = {p.name: p for p in model.parameters}
    for name, value in {"link_inertia": 0.5, "gravity_torque_1": 6.0}.items():
        low, high = result[name].ci95 or (np.inf, -np.inf)
        assert low < value < high


def codes_of(study: sw.Study, log: Mapping[str, FloatArray], *options: str) -> dict[str, str]:
    run = sw.identify(study, data={"m": log}, options=options or None).run
    assert run is not None
    return {w.code: w.message for w in run.warnings}


@pytest.mark.parametrize(
    ("scale", "text"), [(0.5 / np.pi, "covers"), (4096.0 / (2.0 * np.pi), "as encoder counts are")]
)
def test_units_that_no_channel_shows_are_said_to_be_assumed(
    tmp_path: Path, scale: float, text: str
) -> None:
    log = Pendulum(gravity=0.0).log()
    reading = scale * log["theta_m1"]
    log["theta_m1"] = np.round(reading) if scale > 1.0 else reading
    assert text in codes_of(study_of(tmp_path, gravity=False), log)["units-assumed"]
    log["omega_m1"] = np.gradient(log["theta_m1"], SAMPLE_TIME)
    assert "units-assumed" not in codes_of(study_of(tmp_path, gravity=False), log)


def test_an_offset_that_gravity_cancels_is_implausible(tmp_path: Path) -> None:
    """Angles in turns cover a small part of a turn, in which gravity is nearly constant."""
    log = Pendulum().log()
    assert "implausible" not in codes_of(study_of(tmp_path), log)
    log["theta_m1"] = log["theta_m1"] / (2.0 * np.pi)
    said = codes_of(study_of(tmp_path), log, "accept=wrong-unit")
    assert "exceeds every torque" in said["implausible"]
