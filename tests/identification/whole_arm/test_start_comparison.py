"""Several starting values: independent of their order and of starts that cannot be simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import ArmModel, JointModel, Parameter
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm import fit_whole_arm
from tuning_runs import joint_models, rigid_model, shaken

NEAR, FAR = 0.02, 6.0  # relative error of a good start; stiffness factor of a poor start
VAGUE = 80.0  # stiffness factor of a start whose interval contains zero
STIFF = 1e12  # stiffness for which the integration fails


def starts(factor: float) -> tuple[JointModel, ...]:
    """Joint models near the true values, except for the stiffness of joint 2."""
    study, values, _ = shaken()
    joints = joint_models(study, values, NEAR, np.ones((2, 6)))
    stiffness = factor * joints[1].values["gear_stiffness"]
    return joints[0], replace(joints[1], values={**joints[1].values, "gear_stiffness": stiffness})


def whole_arm(first: Sequence[JointModel], *others: Sequence[JointModel]) -> ArmModel:
    study, values, logs = shaken()
    model = rigid_model(study, values, 0.02)
    return fit_whole_arm(logs, model, first, Arm.of(study.arm), others=others)


def test_the_records_choose_in_any_order() -> None:
    reference = whole_arm(starts(1.0))
    for order in ((1.0, FAR), (FAR, 1.0)):
        model = whole_arm(*(starts(factor) for factor in order))
        assert model.status == "converged"
        for p, q in zip(model.parameters, reference.parameters, strict=True):
            if p.value is not None and q.value is not None and q.std:
                # the bandwidth depends on the resonances of the start
                assert abs(p.value - q.value) < 0.5 * q.std, p.label


def test_a_start_at_the_limit_of_its_range_moves_the_range() -> None:
    _, values, _ = shaken()
    model = whole_arm(starts(FAR), starts(0.9 * FAR))
    k = model.values["gear_stiffness", 2]
    assert model.status == "converged"
    assert k == pytest.approx(values["gear_stiffness", 2], rel=0.02)


def test_a_vague_stiffness_is_searched_from_a_typical_one() -> None:
    """As of a joint whose accelerometer resonates on its mount."""
    _, values, _ = shaken()
    joints = starts(VAGUE)
    stiffness = VAGUE * values["gear_stiffness", 2]
    vague = Parameter.estimated(("gear_stiffness", 2), stiffness, stiffness, "N m/rad", "decoupled")
    model = whole_arm((joints[0], replace(joints[1], parameters=(vague,))))
    assert model.values["gear_stiffness", 2] == pytest.approx(values["gear_stiffness", 2], rel=0.02)


def test_candidates_that_cannot_be_simulated_are_skipped() -> None:
    _, values, _ = shaken()
    model = whole_arm(starts(STIFF), starts(1.0))
    assert model.values["gear_stiffness", 2] == pytest.approx(values["gear_stiffness", 2], rel=0.02)


def test_starts_that_cannot_be_simulated_are_refused() -> None:
    with pytest.raises(NotIdentifiable):
        whole_arm(starts(STIFF), starts(2.0 * STIFF))
