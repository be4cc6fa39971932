"""Values that the data do not determine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import ArmDescription, Joint
from strainwave.domain.arm.assumed_values import (
    OF_CURVE,
    OF_DAMPING,
    OF_FRICTION,
    OF_GEAR,
    OF_LINKS,
    TYPICAL_ANTI_RESONANCE_HZ,
    assume_missing,
)
from strainwave.domain.arm.base_parameters import base_parameters, link_inertia
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.consistent_links import is_consistent
from strainwave.domain.arm.description import Origin
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.virtual import scara

PLANAR = scara.STIFF.study(Path("nowhere")).arm
CHAIN = ArmDescription(
    "serial",
    tuple(
        Joint("linear", 0.01, origin=Origin((0.3, 0.0, 0.1), (0.5 * np.pi * i, 0.0, 0.0)))
        for i in range(3)
    ),
    gravity=(0.0, 0.0, -9.81),
)


def test_known_values_stay_and_all_parameters_have_one() -> None:
    truth = scara.STIFF.parameters()
    for missing in truth:
        known = {key: value for key, value in truth.items() if key != missing}
        assumed = assume_missing(known, PLANAR)
        Arm.of(PLANAR).parameter_vector(assumed.values)  # raises if one is missing
        assert known.items() <= assumed.values.items()
        assert missing in assumed.reasons or assumed.values[missing] == 0.0


@pytest.mark.parametrize("missing", ["alpha", "beta", "gamma"])
def test_an_unknown_inertia_leaves_the_inertia_matrix_positive_definite(missing: str) -> None:
    known = scara.STIFF.parameters(5)
    del known[missing, None]
    assumed = assume_missing(known, PLANAR)
    alpha, beta, gamma = (assumed.values[name, None] for name in ("alpha", "beta", "gamma"))
    assert alpha * beta > gamma**2
    assert assumed.reasons[missing, None] == OF_LINKS


def test_a_sum_with_an_unknown_motor_is_split_exactly() -> None:
    known = scara.STIFF.parameters()
    n2 = PLANAR.joints[0].gear_ratio ** 2
    total = known.pop(("alpha", None)) + known.pop(("motor_inertia", 1)) / n2
    values = assume_missing(known | {("rigid_inertia", 1): total}, PLANAR).values
    assert values["alpha", None] + values["motor_inertia", 1] / n2 == pytest.approx(total)
    assert values["motor_inertia", 1] > 0.0


def test_links_of_a_chain_are_bodies_with_the_known_base_parameters() -> None:
    true = assume_missing({("motor_inertia", i): 1e-4 * i for i in (1, 2, 3)}, CHAIN).values
    columns = base_parameters(CHAIN).columns
    known: Values = {c.key: 1.3 * value_of(c.parts, true) for c in columns}
    known |= {("motor_inertia", i): 1.3 * true["motor_inertia", i] for i in (1, 2, 3)}
    values = assume_missing(known, CHAIN).values
    for column in columns:  # 1.3 times a body is a body
        size = max(abs(known[c.key]) for c in columns if c.unit == column.unit)
        assert value_of(column.parts, values) == pytest.approx(known[column.key], abs=5e-3 * size)
    for i in (1, 2, 3):
        link = tuple(values[f"link_{name}", i] for name in LINK_PARAMETERS)
        assert is_consistent(link)


def test_a_gear_has_the_usual_anti_resonance_and_no_friction_is_assumed() -> None:
    known = {key: v for key, v in scara.STIFF.parameters().items() if key[1] is None}
    linear = PLANAR.with_joints(replace(joint, spring="linear") for joint in PLANAR.joints)
    assumed = assume_missing(known, linear)
    inertia = value_of(link_inertia(linear, 2), assumed.values)
    hertz = np.sqrt(assumed.values["gear_stiffness", 2] / inertia) / (2.0 * np.pi)
    assert hertz == pytest.approx(TYPICAL_ANTI_RESONANCE_HZ)
    assert assumed.reasons["gear_stiffness", 2] == OF_GEAR
    assert assumed.reasons["gear_damping", 2] == OF_DAMPING
    assert assumed.values["motor_coulomb_friction", 1] == 0.0
    assert assumed.reasons["motor_coulomb_friction", 1] == OF_FRICTION


def test_a_partly_known_curve_continues() -> None:
    known = scara.STIFF.parameters()
    del known["gear_stiffness_k3", 1], known["gear_knee_t1", 1]
    assumed = assume_missing(known, PLANAR)
    values = assumed.values
    assert values["gear_stiffness_k3", 1] == known["gear_stiffness_k2", 1]
    assert 0.0 < values["gear_knee_t1", 1] < values["gear_knee_t2", 1]
    assert assumed.reasons["gear_stiffness_k3", 1] == OF_CURVE
