"""Simulation of a study with `spring = "auto"`: the parameters state the law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import Study
from strainwave.errors import InvalidInput
from strainwave.virtual import scara
from tuning_runs import shaken_study, simulated_logs


def study_with(spring: str) -> Study:
    study = shaken_study(
        scara.STIFF.study(Path("nowhere"), "three-slope"), 10.0, order=6, joints=(1,)
    )
    joints = (replace(joint, spring=spring) for joint in study.arm.joints)
    return replace(study, arm=study.arm.with_joints(joints))


@pytest.mark.parametrize("law", ["linear", "three-slope"])
def test_the_parameters_state_the_law(law: str) -> None:
    values = scara.STIFF.parameters(5, law)
    written, (log,) = simulated_logs(study_with("auto"), values)
    _, (expected,) = simulated_logs(study_with(law), values)
    for name, channel in expected.channels.items():
        np.testing.assert_array_equal(log.channels[name], channel)
    assert [joint.spring for joint in written.arm.joints] == ["auto", "auto"]


def test_parameters_without_a_stiffness_are_refused() -> None:
    values = scara.STIFF.parameters(5, "linear")
    del values["gear_stiffness", 2]
    with pytest.raises(InvalidInput, match="gear_stiffness of joint 2"):
        simulated_logs(study_with("auto"), values)
