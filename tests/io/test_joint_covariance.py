"""The joint covariance in result.json: whose it is, and that it comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import elastic_identification
from results import arm_model, identification
from strainwave.domain import Parameter
from strainwave.errors import InvalidInput
from strainwave.io import results
from strainwave.io.joint_covariance import covariance_of, joint_covariance


def test_the_rigid_step_s_own_without_what_it_did_not_identify() -> None:
    known = joint_covariance(identification())
    assert known is not None
    assert (known.stage, known.names) == ("rigid", ("inertia 1",))
    np.testing.assert_array_equal(known.matrix, [[4e-8]])


def test_the_whole_arm_fit_s_comes_back_from_the_file() -> None:
    S = np.array([[4e-8, 1e-8, 0.0], [1e-8, 1e-4, 0.0], [0.0, 0.0, 9.0]])
    parameters = (
        Parameter("beta", None, 0.02, 2e-4, "kg m^2", "tuned", (0.0196, 0.0204)),
        Parameter("motor_coulomb_friction", 1, 0.05, 1e-2, "N m", "tuned", (0.03, 0.07)),
        Parameter("link_viscous_friction", 1, None, None, "N m s/rad", "tuned"),
    )
    found = replace(identification(), tuned=arm_model(parameters, S))
    back = covariance_of(results.to_document(found))
    assert back is not None
    assert (back.stage, back.names) == ("tuned", ("beta", "motor_coulomb_friction 1"))
    np.testing.assert_array_equal(back.matrix, S[:2, :2])


def test_joints_models_make_blocks() -> None:
    found = elastic_identification()
    known = joint_covariance(replace(found, tuned=None))
    assert known is not None
    assert known.stage == "decoupled"
    published = {p.label: p.std or 0.0 for p in replace(found, tuned=None).parameters}
    std = np.sqrt(np.diag(known.matrix))
    np.testing.assert_allclose(std, [published[name] for name in known.names], rtol=1e-8)


def test_a_value_that_was_clipped_has_no_covariance() -> None:
    S = np.diag([4e-8, 1e-4])
    parameters = (
        Parameter("beta", None, 0.02, 2e-4, "kg m^2", "tuned", (0.0196, 0.0204)),
        Parameter("gear_damping", 1, -1e-3, 1e-2, "N m s/rad", "tuned", (-0.02, 0.02)),
    )
    found = replace(identification(), tuned=arm_model(parameters, S))
    known = joint_covariance(found)
    assert known is not None
    assert known.names == ("beta",)


def test_a_result_of_an_earlier_version_has_none() -> None:
    assert covariance_of({"parameters": []}) is None
    assert covariance_of({"covariance": None}) is None


@pytest.mark.parametrize(
    "table",
    [
        {"stage": "tuned", "names": ["beta"]},
        {"stage": "tuned", "names": ["beta"], "matrix": [[1.0, 0.0]]},
        {"stage": "tuned", "names": ["beta"], "matrix": [[None]]},
        {"stage": "tuned", "names": ["beta"], "matrix": "one"},
    ],
)
def test_one_that_is_broken_is_refused(table: dict[str, object]) -> None:
    with pytest.raises(InvalidInput, match="covariance"):
        covariance_of({"covariance": table})
