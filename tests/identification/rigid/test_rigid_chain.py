"""Rigid step of arms with more than two joints: base parameters and torque constants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from extensions import added
from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    Experiment,
    FloatArray,
    Joint,
    Origin,
    Servo,
    Signals,
    Study,
)
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.kinds import KINDS, Fault, Kind
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import friction_per_size
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification import rigid, validation
from strainwave.virtual.experiments import simulate_study
from virtual_arms import exact_motion, exact_signals

RATIOS = (0.01, -0.02, 0.0125)
COUPLING = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 1.0))
BODY = {"mass": 3.0, "first_moment_x": 0.3, "first_moment_y": 0.05, "first_moment_z": 0.02}
BODY |= {"inertia_xx": 0.1, "inertia_yy": 0.16, "inertia_zz": 0.14, "inertia_xy": 0.01}
FRICTION = (2e-4, 0.03, 0.002)  # viscous, Coulomb, offset of each motor
FRICTION_NAMES = ("motor_viscous_friction", "motor_coulomb_friction", "friction_offset")
ROTOR_INERTIA = 1e-4  # [kg m^2] of each motor
LINK_FRICTION = 0.4  # [N m s/rad] of each link


@dataclass(frozen=True, slots=True)
class NoKeys:
    """The arm table has no keys of its own."""


class Chain(Kind[NoKeys]):
    """A kind without a program of its own."""

    name = "three-joint-chain"
    table = NoKeys

    def faults(self, table: NoKeys, joints: Sequence[Joint]) -> Iterator[Fault]:
        yield from ()

    def construct(
        self, table: NoKeys, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        return ArmDescription(self.name, tuple(joints), servo=servo)

    def table_of(self, arm: ArmDescription) -> NoKeys:
        return NoKeys()


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    with added(KINDS, Chain()):
        yield


def chain() -> Arm:
    """A vertical axis and two parallel horizontal axes; motor 2 also turns link 3."""
    turned = (0.5 * np.pi, 0.0, 0.0)
    origins = (Origin(), Origin((0.0, 0.0, 0.3), turned), Origin((0.25, 0.0, 0.0)))
    joints = tuple(
        Joint(spring="rigid", gear_ratio=ratio, origin=origin)
        for ratio, origin in zip(RATIOS, origins, strict=True)
    )
    return Arm.of(ArmDescription(Chain.name, joints, (0.0, 0.0, -9.81), coupling=COUPLING))


def rigid_values(arm: Arm) -> FloatArray:
    """True values of the rigid model, (n_parameters,)."""
    values: Values = dict.fromkeys(arm.parameter_names, 0.0)
    for joint in (1, 2, 3):
        values |= {(f"link_{name}", joint): value for name, value in BODY.items()}
        values["motor_inertia", joint] = ROTOR_INERTIA
        values["link_viscous_friction", joint] = LINK_FRICTION
        for name, value in zip(FRICTION_NAMES, FRICTION, strict=True):
            values[name, joint] = value
    return np.array([value_of(column.parts, values) for column in arm.rigid_columns])


def signals_of(arm: Arm, seed: int = 1) -> Signals:
    motion = exact_motion(3, seed)
    body = arm.rigid_regressor(*map(arm.links_of, motion[1:])) @ rigid_values(arm)[: arm.n_body]
    viscous, coulomb, offset = FRICTION
    friction = viscous * motion[2] + coulomb * np.sign(motion[2]) + offset
    of_links = arm.motors_of(LINK_FRICTION * arm.links_of(motion[2]))
    return exact_signals(motion, body + friction + of_links)


def test_base_parameters_of_a_coupled_chain_are_recovered() -> None:
    arm = chain()
    model = rigid.fit_rigid([signals_of(arm)], arm, rigid.RigidOptions(bandwidth_hz=5.0))
    assert model.status == "determined"
    # motor 2 turns links 2 and 3, so its torque shows the friction of link 3
    assert model.value("link_viscous_friction", 3) == pytest.approx(LINK_FRICTION, rel=1e-6)
    np.testing.assert_allclose(model.solution, rigid_values(arm), rtol=1e-6, atol=1e-7)
    # M(q) is symmetric: the torque constants agree
    assert set(model.torque_ratios) == {2, 3}
    for value, _ in model.torque_ratios.values():
        assert value == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("joint", [2, 3])
def test_the_joint_with_a_wrong_torque_constant_shows(joint: int) -> None:
    arm = chain()
    signals = signals_of(arm)
    gain = np.where(np.arange(1, 4) == joint, 0.9, 1.0)
    wrong = replace(signals, motor_torque=gain * signals.motor_torque)
    model = rigid.fit_rigid([wrong], arm, rigid.RigidOptions(bandwidth_hz=5.0))
    for number, (value, _) in model.torque_ratios.items():
        assert value == pytest.approx(1.0 / gain[number - 1], abs=1e-6)


SERVO = Servo("pi-velocity", 1e-3, (0.1, 0.1, 0.05), (0.8, 0.8, 0.4), 10.0, (5.0, 5.0, 5.0))
ELASTIC = {"motor_inertia": 2e-4, "motor_coulomb_friction": 0.03, "gear_stiffness": 4e3}
ELASTIC |= {"gear_damping": 10.0, "motor_viscous_friction": 2e-4, "link_viscous_friction": 4.0}


def elastic_chain(folder: Path) -> tuple[Study, Values]:
    """A chain whose first anti-resonances are near 12 Hz."""
    joints = tuple(
        replace(joint, spring="linear", gear_ratio=0.01, torque_per_volt=gain, encoder_counts=8192)
        for joint, gain in zip(chain().joints, (0.18, 0.15, 0.07), strict=True)
    )
    arm = ArmDescription("serial", joints, (0.0, 0.0, -9.81), servo=SERVO)
    values: Values = dict.fromkeys(Arm.of(arm).base_names, 0.0)
    for joint in (1, 2, 3):
        values |= {(f"link_{name}", joint): value for name, value in BODY.items()}
        values |= {(name, joint): value for name, value in ELASTIC.items()}
    experiment = Experiment("motion", "motion.parquet", "motion", ("servo",) * 3)
    return Study(arm=arm, experiments=(experiment,), path=folder / "study.toml"), values


def test_viscous_friction_of_elastic_joints_acts_on_the_links_as_well(tmp_path: Path) -> None:
    """With all of it at the motors, that of joint 2 is 0.66 % too large, five standard deviations."""
    study, values = elastic_chain(tmp_path)
    simulate_study(study, values, tmp_path, noise=SensorNoise(), as_recorded=False)
    model = pipeline.identify(tmp_path / "study.toml", stages=("rigid",)).rigid
    assert model is not None
    for joint in (1, 2, 3):
        parameter = next(p for p in model.parameters if p.key == ("total_viscous_friction", joint))
        motor, link = (values[f"{side}_viscous_friction", joint] for side in ("motor", "link"))
        assert parameter.std is not None
        expected = motor + 1e-4 * link
        assert parameter.value == pytest.approx(expected, rel=0.004)
        assert parameter.value == pytest.approx(expected, abs=3.5 * parameter.std)


LAWS = {
    "load-friction": (0.15, 1.0),
    "stribeck": (0.02, 12.0),
    "power-friction": (0.04, 0.5),
}


def with_term(effect: str | None, seed: int) -> Signals:
    """A noisy record of the chain, with a further term of friction at joint 2."""
    exact, arm = signals_of(chain(), seed), chain()
    torque = exact.motor_torque + np.random.default_rng(seed).normal(
        0.0, 5e-3, (len(exact.time), 3)
    )
    if effect is not None:
        size, shape = LAWS[effect]
        motion = exact.motor_angle, exact.motor_velocity, exact.motor_acceleration
        load = arm.rigid_regressor(*map(arm.links_of, motion)) @ rigid_values(arm)[: arm.n_body]
        load -= ROTOR_INERTIA * exact.motor_acceleration
        velocity = exact.motor_velocity[:, 1]
        law = friction_per_size(effect, shape, velocity, load[:, 1])
        torque[:, 1] += size * law * np.sign(velocity)
    return replace(exact, motor_torque=torque)


@pytest.mark.parametrize("effect", [None, *LAWS])
def test_further_friction_is_found_where_it_is(effect: str | None) -> None:
    arm, options = chain(), rigid.RigidOptions(bandwidth_hz=8.0)
    model = rigid.fit_rigid([with_term(effect, 1)], arm, options)
    assert [(t.effect, t.joint) for t in model.friction_terms] == ([(effect, 2)] if effect else [])
    errors = np.abs(model.solution - rigid_values(arm)) / np.sqrt(np.diag(model.covariance))
    assert np.max(errors) < 4.5
    if effect is not None:
        (term,) = model.friction_terms
        for parameter, true in zip(term.parameters, LAWS[effect], strict=False):
            assert parameter.std is not None
            assert parameter.value == pytest.approx(true, rel=0.3)
            assert parameter.value == pytest.approx(true, abs=4.0 * parameter.std)
        other = with_term(effect, 2)
        fits = validation.predict_rigid(model, other, arm).fit_percent
        plain = replace(model, friction_terms=())
        assert fits["torque2"] > validation.predict_rigid(plain, other, arm).fit_percent["torque2"]
