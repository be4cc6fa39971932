"""Each kind of arm: consistency of its relations between inertias."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain import ArmDescription, Joint
from strainwave.domain.arm.base_parameters import base_parameters, link_inertia
from strainwave.domain.arm.combinations import (
    inertias_of_links,
    is_rigid_drive,
    lumped_inertias,
    reported,
    rigid_columns,
    total_inertia,
    value_of,
)
from strainwave.domain.arm.kinds import KINDS, planar_two_link, single_joint
from strainwave.domain.keys import Values

RATIOS = (0.02, 0.01)


def description(kind: str, gravity: float | None = 9.81) -> ArmDescription:
    joints = [Joint("linear", n) for n in RATIOS]
    if kind == "single-joint":
        return single_joint(joints[0], gravity)
    return planar_two_link(joints, 0.4, gravity)


def random_values(arm: ArmDescription, seed: int) -> Values:
    """Random values of every parameter of a combination."""
    rng = np.random.default_rng(seed)
    names = ("motor_inertia", "motor_viscous_friction", "link_viscous_friction", "friction_offset")
    numbers = range(1, arm.n_joints + 1)
    keys = [*base_parameters(arm).links, *((name, i) for name in names for i in numbers)]
    keys += [("motor_coulomb_friction", i) for i in numbers]
    return {key: float(rng.uniform(0.5, 2.0)) for key in keys}


@pytest.mark.parametrize("kind", KINDS)
def test_inertias_follow_from_link_inertias(kind: str) -> None:
    arm = description(kind)
    values = random_values(arm, 1)
    numbers = range(1, arm.n_joints + 1)
    links = {("link_inertia", i): value_of(link_inertia(arm, i), values) for i in numbers}
    inverted: Values = {
        key: v for key, v in values.items() if key not in dict(inertias_of_links(arm))
    }
    for key, row in inertias_of_links(arm):
        inverted[key] = value_of(row, inverted | links)
    assert inverted == pytest.approx(values)


@pytest.mark.parametrize("kind", KINDS)
def test_the_total_inertia_follows_from_the_rigid_unknowns(kind: str) -> None:
    """c_1 = m_M + n^2 m_L, (18)."""
    arm = description(kind)
    values = random_values(arm, 2)
    rigid = {column.key: value_of(column.parts, values) for column in rigid_columns(arm)}
    for number, joint in enumerate(arm.joints, start=1):
        link = value_of(link_inertia(arm, number), values)
        expected = values["motor_inertia", number] + joint.gear_ratio**2 * link
        assert value_of(total_inertia(arm, number), rigid) == pytest.approx(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_reported_combinations_are_not_parameters(kind: str) -> None:
    arm = description(kind)
    rows = reported(arm)
    assert not rows.keys() & random_values(arm, 3).keys()
    assert lumped_inertias(arm).items() <= rows.items()
    assert {("total_viscous_friction", i + 1) for i in range(arm.n_joints)} <= rows.keys()


def test_rigid_columns_depend_on_gravity_and_gears() -> None:
    names = [str(column) for column in rigid_columns(description("planar-two-link", None))]
    assert names[:4] == ["rigid_inertia of joint 1", "motor_inertia of joint 2", "beta", "gamma"]
    assert names[4] == "total_viscous_friction of joint 1"
    drive = single_joint(Joint("rigid", 0.1, motion="prismatic"))
    assert is_rigid_drive(drive)
    assert [(c.name, c.unit) for c in rigid_columns(drive)] == [
        ("inertia", "kg"),
        ("motor_viscous_friction", "N s/m"),
        ("motor_coulomb_friction", "N"),
        ("friction_offset", "N"),
    ]
