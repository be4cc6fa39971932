"""Correlations of parameter errors: values, derived parameters, and strong pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from results import arm_model, identification
from strainwave.domain import Parameter
from strainwave.report.document import parameters
from strainwave.report.figures import HeatMap


def parameter(name: str, value: float | None = 1.0, joint: int | None = 1) -> Parameter:
    return Parameter(name, joint, value, 0.1, "-", "tuned")


def correlations_of(names: list[str], covariance: list[list[float]]) -> HeatMap | None:
    whole_arm = arm_model(tuple(parameter(name) for name in names), np.array(covariance))
    return parameters.correlations(replace(identification(), whole_arm=whole_arm))


def test_correlations_are_normalised_covariances() -> None:
    errors = correlations_of(["gear_stiffness", "gear_damping"], [[4.0, -5.88], [-5.88, 9.0]])
    assert errors is not None
    assert errors.names == ("gear stiffness 1", "gear damping 1")
    assert errors.values[0, 1] == pytest.approx(-0.98)
    assert "gear stiffness 1 and gear damping 1 (-0.980)" in parameters.describe_correlations(
        errors
    )
    assert errors.values[1] == pytest.approx([-0.98, 1.0])


def test_weak_correlations_are_not_listed() -> None:
    errors = correlations_of(["gear_stiffness", "gear_damping"], [[1.0, 0.9], [0.9, 1.0]])
    assert errors is not None
    assert (
        "No two parameters have a correlation of 0.95 or more"
        in parameters.describe_correlations(errors)
    )


def test_a_sum_is_left_out_if_its_parts_are_there() -> None:
    names = ["motor_viscous_friction", "gear_damping", "total_viscous_friction"]
    errors = correlations_of(names, np.eye(3).tolist())
    assert errors is not None
    assert errors.names == ("motor viscous friction 1", "gear damping 1")
    alone = correlations_of(names[1:], np.eye(2).tolist())
    assert alone is not None
    assert alone.names == ("gear damping 1", "total viscous friction 1")


def test_unknown_errors_have_no_correlation() -> None:
    assert correlations_of(["gear_damping", "gear_stiffness"], [[np.inf, 0.0], [0.0, 1.0]]) is None
    one = identification()  # one of its two parameters has no value
    assert parameters.correlations(one) is None
    assert parameters.correlations(replace(one, rigid=None)) is None
