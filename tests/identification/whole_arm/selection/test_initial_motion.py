"""Records that start at a reversal of the motor: the fit detects the motion of the links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.starting_values import space_of
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.identification.whole_arm.selection.candidate import add_initial_states
from tuning_runs import beginning, joint_models, later, rig_logs, rigid_model, shaken

CUTOFF = 80.0
FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
TURNS = [(1, 1300), (2, 500)]  # joint and sample of a reversal of its motor in `shaken`


def cut() -> list[Log]:
    return [later(shaken()[2][joint - 1], first) for joint, first in TURNS]


def arm(logs: Sequence[Log], wrong: float = 0.0) -> tuple[Objective, FloatArray]:
    """Objective and coordinates of the true arm, or of an arm with a wrong stiffness."""
    study, true_values, _ = shaken()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    space = space_of(
        rigid_model(study, true_values, 0.01),
        joints,
        Arm.of(study.arm),
        largest_voltage=[10.0, 10.0],
        floor=0.002,
    )
    objective = Objective.of(space, [dataset_of(log, Arm.of(study.arm), CUTOFF) for log in logs])
    stiff = {key: v * (1.0 + wrong) for key, v in true_values.items() if key[0] == "gear_stiffness"}
    z = space.coordinates(true_values | stiff)
    return objective.update_weights(z), z


@pytest.mark.parametrize(("joint", "first"), TURNS)
def test_a_record_from_a_turning_point_is_in_motion(joint: int, first: int) -> None:
    study, true_values, logs = shaken()
    log = logs[joint - 1]
    objective, z = arm([later(log, first)])
    assert not objective.records[0].begins_in_motion  # the motor angles do not show the motion
    corrected = add_initial_states(objective, z)
    assert corrected.records[0].begins_in_motion
    true = beginning(study, true_values, log, first)
    # link angles, which determine the gear torques
    np.testing.assert_allclose(corrected.memory.record_parameters[0][2:4], true[2:4], atol=2e-4)
    assert np.max(np.abs(true[2:4])) > 0.01


@pytest.mark.parametrize("wrong", [0.0, 0.02, 0.1])
def test_records_from_rest_stay_at_rest(wrong: float) -> None:
    logs = [*shaken()[2], *(log for log in rig_logs()[1] if log.name == "step-j1")]
    objective, z = arm(logs, wrong)
    assert add_initial_states(objective, z) is objective


def test_records_from_turning_points_are_fitted() -> None:
    study, true_values, _ = shaken()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    start = (rigid_model(study, true_values, 0.01, 1.0), joints, Arm.of(study.arm))
    model = fit_whole_arm(cut(), *start)
    assert model.status == "converged"
    # a start at standstill gives errors of 0.3 to 2 %, and fits of 68 to 93 %
    for name, joint in model.values:
        if name in ("alpha", "beta", "gamma", "motor_inertia", "gear_stiffness"):
            assert model.values[name, joint] == pytest.approx(true_values[name, joint], rel=0.002)
    assert all(min(fits.values()) > 97.0 for fits in model.fit_percent.values())
