"""The joint covariance in result.json: which stage, which parameters, and reading it back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import elastic_identification
from results import arm_model, identification
from strainwave.domain import Parameter
from strainwave.errors import InvalidInput
from strainwave.io import results
from strainwave.io.joint_covariance import joint_covariance
from strainwave.io.results import covariance_of


def test_rigid_stage_without_unidentified_parameters() -> None:
    known = joint_covariance(identification())
    assert known is not None
    assert (known.stage, known.names) == ("rigid", ("inertia 1",))
    np.testing.assert_array_equal(known.matrix, [[4e-8]])


def test_whole_arm_fit_is_read_back() -> None:
    S = np.array([[4e-8, 1e-8, 0.0], [1e-8, 1e-4, 0.0], [0.0, 0.0, 9.0]])
    parameters = (
        Parameter("beta", None, 0.02, 2e-4, "kg m^2", "tuned", (0.0196, 0.0204)),
        Parameter("motor_coulomb_friction", 1, 0.05, 1e-2, "N m", "tuned", (0.03, 0.07)),
        Parameter("link_viscous_friction", 1, None, None, "N m s/rad", "tuned"),
    )
    found = replace(identification(), whole_arm=arm_model(parameters, S))
    back = covariance_of(results.to_document(found))
    assert back is not None
    frame = back.to_frame()
    assert list(frame.columns) == list(frame.index) == list(back.names)
    assert frame.loc["beta", "motor_coulomb_friction 1"] == 1e-8
    np.testing.assert_allclose(back.correlation, [[1.0, 5e-3], [5e-3, 1.0]])
    assert (back.stage, back.names) == ("tuned", ("beta", "motor_coulomb_friction 1"))
    np.testing.assert_array_equal(back.matrix, S[:2, :2])


def test_joint_models_give_diagonal_blocks() -> None:
    found = elastic_identification()
    known = joint_covariance(replace(found, whole_arm=None))
    assert known is not None
    assert known.stage == "decoupled"
    published = {p.label: p.std or 0.0 for p in replace(found, whole_arm=None).parameters}
    std = np.sqrt(np.diag(known.matrix))
    np.testing.assert_allclose(std, [published[name] for name in known.names], rtol=1e-8)


def test_a_clipped_value_has_no_covariance() -> None:
    S = np.diag([4e-8, 1e-4])
    parameters = (
        Parameter("beta", None, 0.02, 2e-4, "kg m^2", "tuned", (0.0196, 0.0204)),
        Parameter("gear_damping", 1, -1e-3, 1e-2, "N m s/rad", "tuned", (-0.02, 0.02)),
    )
    found = replace(identification(), whole_arm=arm_model(parameters, S))
    known = joint_covariance(found)
    assert known is not None
    assert known.names == ("beta",)


def test_results_of_earlier_versions_have_no_covariance() -> None:
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
def test_an_invalid_covariance_is_refused(table: dict[str, object]) -> None:
    with pytest.raises(InvalidInput, match="covariance"):
        covariance_of({"covariance": table})
