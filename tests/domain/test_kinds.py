"""What each kind of arm says of its links agrees with itself."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from strainwave.domain import ArmDescription, Joint
from strainwave.domain.arm import ArmKind
from strainwave.domain.combinations import (
    is_rigid_drive,
    lumped_inertias,
    reported,
    rigid_columns,
    total_inertia,
    value_of,
)
from strainwave.domain.kinds import KINDS, Values, kind_of

RATIOS = (0.02, 0.01)


def described(kind: ArmKind, gravity: float | None = 9.81) -> ArmDescription:
    joints = tuple(Joint("linear", n) for n in RATIOS[: KINDS[kind].n_joints])
    return ArmDescription(kind, joints, link_length=0.4, gravity=gravity)


def drawn(arm: ArmDescription, seed: int) -> Values:
    """Every parameter that a combination may have."""
    rng = np.random.default_rng(seed)
    names = ("motor_inertia", "motor_viscous_friction", "link_viscous_friction", "friction_offset")
    numbers = range(1, arm.n_joints + 1)
    keys = [*kind_of(arm).inertias, *((name, i) for name in names for i in numbers)]
    keys += [("motor_coulomb_friction", i) for i in numbers]
    keys += [(f"gravity_torque_{i}", None) for i in numbers]
    return {key: float(rng.uniform(0.5, 2.0)) for key in keys}


def test_every_kind_of_a_study_file_is_in_the_table() -> None:
    assert set(KINDS) == set(get_args(ArmKind))


@pytest.mark.parametrize("kind", KINDS)
def test_inertias_follow_from_those_of_the_links(kind: ArmKind) -> None:
    """`from_link_inertias` undoes `link_inertia`."""
    arm = described(kind)
    values = drawn(arm, 1)
    own = kind_of(arm)
    numbers = range(1, arm.n_joints + 1)
    links = {("link_inertia", i): value_of(own.link_inertia(i), values) for i in numbers}
    found: Values = {key: v for key, v in values.items() if key not in dict(own.from_link_inertias)}
    for key, row in own.from_link_inertias:
        found[key] = value_of(row, found | links)
    assert found == pytest.approx(values)


@pytest.mark.parametrize("kind", KINDS)
def test_the_total_inertia_is_the_motor_s_and_the_link_s(kind: ArmKind) -> None:
    """c_1 = m_M + n^2 m_L out of the rigid model's unknowns alone: (18)."""
    arm = described(kind)
    values = drawn(arm, 2)
    rigid = {column.key: value_of(column.parts, values) for column in rigid_columns(arm)}
    for number, joint in enumerate(arm.joints, start=1):
        link = value_of(kind_of(arm).link_inertia(number), values)
        expected = values["motor_inertia", number] + joint.gear_ratio**2 * link
        assert value_of(total_inertia(arm, number), rigid) == pytest.approx(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_reported_combinations_are_no_parameters(kind: ArmKind) -> None:
    arm = described(kind)
    found = reported(arm)
    assert not found.keys() & drawn(arm, 3).keys()
    assert lumped_inertias(arm).items() <= found.items()
    assert {("total_viscous_friction", i + 1) for i in range(arm.n_joints)} <= found.keys()


def test_what_rigid_motion_identifies_depends_on_gravity_and_gears() -> None:
    names = [str(column) for column in rigid_columns(described("planar-two-link", None))]
    assert names[:4] == ["rigid_inertia of joint 1", "motor_inertia of joint 2", "beta", "gamma"]
    assert names[4] == "total_viscous_friction of joint 1"
    drive = ArmDescription("single-joint", (Joint("rigid", 0.1, motion="prismatic"),))
    assert is_rigid_drive(drive)
    assert [(c.name, c.unit) for c in rigid_columns(drive)] == [
        ("inertia", "kg"),
        ("motor_viscous_friction", "N s/m"),
        ("motor_coulomb_friction", "N"),
        ("friction_offset", "N"),
    ]
