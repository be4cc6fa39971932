"""Sizes of robot joints: every gear of the catalogue lies inside, a wrong unit is named."""

from __future__ import annotations

import pytest
from benchmarks.families.catalogue import drawn

from strainwave.domain import ArmDescription, Joint, Parameter
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.results.estimates import is_physical, size_warnings

GEAR_CATALOGUE = {
    8: (440.0, 1200.0),
    11: (2200.0, 4400.0),
    14: (3400.0, 7100.0),
    17: (8100.0, 1.6e4),
    20: (1.3e4, 2.9e4),
    25: (2.5e4, 5.7e4),
    32: (5.4e4, 1.2e5),
    40: (1e5, 2.3e5),
}
"""Lowest and highest stiffness [N m/rad] by size, of docs/theory.md."""


def arm(e: float | None = 0.08, ratio: float = 0.01, motion: str = "revolute") -> ArmDescription:
    joint = Joint("linear", ratio, motion, e)  # type: ignore[arg-type]
    return single_joint(joint)


def value(name: str, size: float, unit: str = "N m/rad") -> Parameter:
    return Parameter(name, 1, size, 0.01 * size, unit, "tuned")


@pytest.mark.parametrize("size", GEAR_CATALOGUE)
def test_every_gear_of_the_catalogue_is_plausible(size: int) -> None:
    for stiffness in GEAR_CATALOGUE[size]:
        assert not list(size_warnings(arm(), [value("gear_stiffness", stiffness)]))


def test_drawn_arms_over_the_catalogue_are_plausible() -> None:
    for seed in range(60):
        rig = drawn(seed, 5)
        known = [
            Parameter(name, joint, size, 0.0, "1", "tuned")
            for (name, joint), size in rig.values.items()
        ]
        assert not list(size_warnings(rig.study.arm, known))


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "mN m"), (1e-3, "kN m")], ids=["too large", "too small"]
)
def test_the_unit_of_a_torque_constant_is_named(factor: float, unit: str) -> None:
    """As observed: 90 mN m/V given as 90 gave a stiffness of 1.6e7."""
    right = {"gear_stiffness": 1.6e4, "motor_inertia": 1.5e-4, "link_inertia": 3.0}
    wrong = [value(name, size * factor) for name, size in right.items()]
    (found,) = size_warnings(arm(0.09 * factor), wrong)
    assert f"torque_per_volt is likely in {unit}/V" in found.message
    assert "torque_per_volt = 0.09" in found.message
    (logged,) = size_warnings(arm(None), wrong)
    assert f"torque1 is likely in {unit}" in logged.message


def test_an_angle_in_degrees_is_named() -> None:
    """Inertias and stiffness are too small by 57 while the torque constant is right."""
    wrong = [value("gear_stiffness", 440.0 / 57.3), value("motor_inertia", 1e-6 / 57.3)]
    # a larger unit of the torque constant would bring it out of its own range
    (found,) = size_warnings(arm(19.0), wrong)
    assert "theta_m1 is likely in degrees" in found.message


def test_sizes_that_no_unit_explains_give_a_remedy_for_all_units() -> None:
    wrong = [value("gear_stiffness", 1e30), value("motor_inertia", 1e-30)]
    (found,) = size_warnings(arm(), wrong)
    assert "check the units" in found.message


def test_prismatic_joints_are_not_checked() -> None:
    assert not list(size_warnings(arm(35.0, 1.0, "prismatic"), [value("inertia", 1e5, "kg")]))


@pytest.mark.parametrize(
    ("name", "size", "possible"),
    [("gear_stiffness", 0.0, False), ("gear_damping", 0.0, True), ("friction_offset", -1.0, True)],
)
def test_physically_possible_signs(name: str, size: float, *, possible: bool) -> None:
    assert is_physical(name, size) == possible
    assert not is_physical(name, float("nan"))


def test_a_value_at_its_bound_of_zero_has_no_size() -> None:
    """An arm without rotor inertia is no fault of units."""
    bounded = Parameter("motor_inertia", 1, 0.0, 1e-3, "kg m^2", "rigid", (0.0, 2e-3))
    assert not list(size_warnings(arm(), [bounded]))
