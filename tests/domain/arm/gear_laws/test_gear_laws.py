"""Each gear law: consistency of its functions, agreement with the core, and its registration."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from extensions import added
from strainwave import _core
from strainwave.domain import FloatArray, Joint, is_physical
from strainwave.domain.arm import gear_laws
from strainwave.domain.arm.description import unit_of
from strainwave.domain.arm.gear_laws import STIFFNESS, GearLaw, Linear, gear_law
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.parameters import parameter_descriptions, whole_arm_parameter_names
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.report.document.gears import (
    StiffnessCurve,
    describe,
    stiffness_figure,
    torsion_figure,
)
from virtual_arms import ELASTIC_JOINT

LAWS = [*gear_laws.LAWS.values()]
ELASTIC = [law for law in LAWS if law.elastic]
LARGEST = 60.0
STUDY = """
[arm]
kind = "single-joint"

[[joint]]
spring = "{spring}"
gear_ratio = 0.01

[[experiment]]
name = "prbs"
file = "prbs.csv"
use = "frequency"
joint = 1
"""


def random_values(law: GearLaw, seed: int) -> dict[str, float]:
    """Random parameters around the starting values of a fit."""
    rng = np.random.default_rng(seed)
    values: dict[str, float] = {}
    starts = law.starts(float(10.0 ** rng.uniform(3.0, 5.0)), LARGEST)
    for p in law.parameters:
        below = 0.0 if p.above is None else starts[p.above]
        excess = (starts[p.name] - below) * float(rng.uniform(0.6, 1.5))
        values[p.name] = excess if p.above is None else values[p.above] + excess
    return values


def torsions(law: GearLaw, values: dict[str, float]) -> FloatArray:
    """Torsions of both signs that avoid the knees."""
    torque = np.linspace(-1.1 * LARGEST, 1.1 * LARGEST, 97)
    for knee in law.knees(values):
        torque = torque[np.abs(np.abs(torque) - knee) > 0.05]
    return law.torsion(values, torque)


def joint_of(law: GearLaw) -> Joint:
    return Joint(law.name, 0.01)


@pytest.fixture
def registered() -> Iterator[GearLaw]:
    law = Toy()
    with added(gear_laws.LAWS, law):
        yield law


class Toy(Linear):
    """A linear law with another name."""

    name = "toy"

    @property
    def core_name(self) -> str:
        return "linear"


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@given(seed=st.integers(0, 2**31))
def test_the_torque_is_odd(law: GearLaw, seed: int) -> None:
    values, at = random_values(law, seed), np.linspace(0.0, 3e-3, 20)
    np.testing.assert_array_equal(law.torque(values, -at), -law.torque(values, at))
    np.testing.assert_array_equal(law.stiffness(values, -at), law.stiffness(values, at))
    np.testing.assert_array_equal(law.jacobian(values, -at), -law.jacobian(values, at))


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
@given(seed=st.integers(0, 2**31))
def test_the_stiffness_is_the_derivative_of_the_torque(law: GearLaw, seed: int) -> None:
    values = random_values(law, seed)
    at, off = torsions(law, values), 1e-9
    slope = (law.torque(values, at + off) - law.torque(values, at - off)) / (2.0 * off)
    np.testing.assert_allclose(
        law.stiffness(values, at), slope, rtol=1e-4
    )  # rounding of the differences
    low, high = law.stiffness_range(values)
    assert 0.0 < low <= high
    assert np.all(law.stiffness(values, at) >= 0.999 * low)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
@given(seed=st.integers(0, 2**31))
def test_jacobians_match_differences(law: GearLaw, seed: int) -> None:
    values = random_values(law, seed)
    at = torsions(law, values)
    J, K = law.jacobian(values, at), law.stiffness_jacobian(values, at)
    assert J.shape == K.shape == (len(at), len(values))
    for k, name in enumerate(values):
        off = 1e-6 * values[name]  # smaller than the distance to a knee
        ends = [{**values, name: values[name] + side * off} for side in (1.0, -1.0)]
        torque = np.subtract(*(law.torque(end, at) for end in ends)) / (2.0 * off)
        stiffness = np.subtract(*(law.stiffness(end, at) for end in ends)) / (2.0 * off)
        # differences of numbers that agree in six digits or hardly affect the torque
        np.testing.assert_allclose(J[:, k], torque, rtol=1e-6, atol=1e-7 * LARGEST / values[name])
        scale = float(np.max(law.stiffness(values, at))) / values[name]
        np.testing.assert_allclose(K[:, k], stiffness, rtol=1e-6, atol=1e-7 * scale)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
@given(seed=st.integers(0, 2**31))
def test_torsion_inverts_torque(law: GearLaw, seed: int) -> None:
    values, torque = random_values(law, seed), np.linspace(-LARGEST, LARGEST, 41)
    inverted = law.torque(values, law.torsion(values, torque))
    np.testing.assert_allclose(inverted, torque, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_parameter_names_match_the_core(law: GearLaw) -> None:
    assert len(set(law.names)) == len(law.names)
    core = Arm.of(single_joint(joint_of(law))).core.parameter_names
    core_names = [name for name, _ in core if name in gear_laws.gear_parameters()]
    assert core_names == list(law.names)
    assert (("gear_damping", 1) in core) == law.elastic


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_the_table_matches_the_core(law: GearLaw) -> None:
    core = [name for owner, name, *_ in _core.parameter_table() if owner == law.name]
    assert list(law.names) == core
    assert (law.name, list(law.names), law.elastic) in _core.gear_laws()
    assert {name for name, *_ in _core.gear_laws()} == set(gear_laws.LAWS)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
def test_the_simulated_gear_follows_the_law(law: GearLaw) -> None:
    """A motor under a reversing torque, and the torque of its gear."""
    starts = law.starts(2.5e4, 30.0)
    values = {key: value for key, value in ELASTIC_JOINT.items() if key[0] != STIFFNESS}
    values |= {(name, 1): value for name, value in starts.items()}
    arm = Arm.of(single_joint(joint_of(law)))
    torque = 2.0 * np.sign(np.sin(np.arange(400) / 20.0))[:, None]
    drive = Drive(1e-3, torque, np.zeros_like(torque), (False,), (0.0,), (0.0,))
    record: list[Quantity] = ["motor_angle", "link_angle", "motor_velocity", "link_velocity"]
    record.append("gear_torque")
    run = simulate(arm, values, drive, sample_time=1e-3, samples=400, record=record)
    torsion = 0.01 * run["motor_angle"] - run["link_angle"]
    rate = 0.01 * run["motor_velocity"] - run["link_velocity"]
    elastic = run["gear_torque"] - values["gear_damping", 1] * rate
    assert np.max(np.abs(elastic)) > 20.0  # beyond every knee
    # rounding of the knees: a quarter of the change of the slope times the width of the corner
    rounded = 0.25 * _core.GEAR_CORNER * sum(starts[name] for name in law.slopes)
    np.testing.assert_allclose(law.torque(starts, torsion[:, 0]), elastic[:, 0], atol=rounded)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_parameters_have_units_and_descriptions_and_are_options(law: GearLaw) -> None:
    arm = single_joint(joint_of(law))
    listed = whole_arm_parameter_names(arm)
    assert len(set(listed)) == len(listed)
    for p in law.parameters:
        assert unit_of(p.name, joint_of(law)) == p.described.units[0]
        assert unit_of(p.name, Joint(law.name, 0.01, motion="prismatic")) == p.described.units[1]
        assert parameter_descriptions()[p.name].symbol == p.described.symbol
        assert {p.name, f"{p.name} 1"} <= set(listed)
        assert p.above is None or p.above in law.names


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
def test_starting_values_are_within_their_ranges(law: GearLaw) -> None:
    starts = law.starts(2e4, LARGEST)
    assert tuple(starts) == law.names
    assert all(is_physical(name, value) and value != 0.0 for name, value in starts.items())
    assert all(starts[p.above] < starts[p.name] for p in law.parameters if p.above is not None)
    # and close to the equivalent linear stiffness
    low, high = law.stiffness_range(starts)
    assert 0.5 * 2e4 < low <= high < 2.0 * 2e4
    assert {law.linearised_by, *law.slopes} <= set(law.names)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
def test_straight_gives_a_linear_law(law: GearLaw) -> None:
    values, at = law.straight(2e4), np.linspace(-3e-3, 3e-3, 31)
    np.testing.assert_allclose(law.torque(values, at), 2e4 * at, rtol=1e-12)
    assert tuple(values) == law.names
    assert law.is_curved == (law.simpler is not None)
    assert gear_laws.determined_law(law.name, {STIFFNESS: 2e4}).name == (law.simpler or law.name)
    assert gear_laws.determined_law(law.name, values) is law


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_lists_in_parameter_files_are_read(law: GearLaw, tmp_path: Path) -> None:
    numbers = {key: [float(k) for k, _ in enumerate(names)] for key, names in law.lists.items()}
    path = tmp_path / "p.json"
    path.write_text(json.dumps({"joints": [numbers]}), encoding="utf-8")
    expected = {(name, 1): float(k) for names in law.lists.values() for k, name in enumerate(names)}
    assert read_parameters(path) == expected
    assert {name for name, _ in expected} <= set(law.names)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
def test_parallel_springs_sum_to_the_law(law: GearLaw) -> None:
    values = law.starts(2e4, LARGEST)
    springs = law.parallel_springs(values.__getitem__)
    if springs is None:
        assert law.is_curved
        return
    at: FloatArray = np.linspace(0.0, 5e-3, 101)
    total = sum(stiffness * np.maximum(at - slack, 0.0) for stiffness, slack in springs)
    np.testing.assert_allclose(total, law.torque(values, at), rtol=1e-9)


@pytest.mark.parametrize("law", ELASTIC, ids=lambda law: law.name)
@pytest.mark.parametrize("count", [None, 1])
def test_the_known_part_of_a_curve_is_drawn(law: GearLaw, count: int | None) -> None:
    values = law.starts(2e4, LARGEST)
    known = law.drawn(tuple(values)[:count])
    assert set(known) <= set(tuple(values)[:count])
    if not known:
        assert law.simpler is not None
        return
    shown = {name: values[name] for name in known}
    curve = StiffnessCurve(
        1, law, shown, np.diag([(0.01 * v) ** 2 for v in shown.values()]), 50.0, None
    )
    slope = stiffness_figure(curve).panels[0].marks[-1]
    assert np.all(np.diff(slope.x) >= 0.0)  # type: ignore[union-attr]
    assert torsion_figure(curve).panels
    assert " ± " in describe(curve)


def test_a_registered_law_is_simulated(registered: GearLaw, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(spring="toy"), encoding="utf-8")
    arm = read_study(path, logs_exist=False).arm
    assert arm.joints[0].law is registered
    assert arm.joints[0].elastic
    assert (STIFFNESS, 1) in Arm.of(arm).parameter_names
    assert f"{STIFFNESS} 1" in whole_arm_parameter_names(arm)
    curve = StiffnessCurve(1, registered, {STIFFNESS: 2e4}, np.array([[1e4]]), 50.0, None)
    assert "Slope 20000 ± 100 N m/rad" in describe(curve)
    assert torsion_figure(curve).panels


def test_an_unknown_law_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(spring="toy"), encoding="utf-8")
    with pytest.raises(
        InvalidInput, match="'spring' is 'toy', but it should be 'auto', 'linear', "
    ) as error:
        read_study(path, logs_exist=False)
    assert f" or {[*gear_laws.LAWS][-1]!r}" in error.value.problem
    assert "line 6" in str(error.value)
    with pytest.raises(InvalidInput, match="no gear law 'toy'"):
        gear_law("toy")


@pytest.mark.parametrize("law", ["linear", "cubic", "three-slope"])
def test_parameters_determine_the_law_of_an_automatic_gear(law: str) -> None:
    """A law has its own parameters; gear_stiffness alone, which cubic gears share, is a line."""
    names = gear_law(law).names
    assert gear_laws.determined_law("auto", names).name == law
    assert gear_laws.determined_law("auto", names[:1]).name == (
        "three-slope" if law == "three-slope" else "linear"
    )
    assert gear_laws.determined_law("auto", ()).name == "linear"
