"""Correlations of parameter errors: values, derived parameters, and strong pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from figure_parts import marks
from results import arm_model, identification
from strainwave.domain import Parameter
from strainwave.presentation.figures import HeatMap
from strainwave.presentation.report import correlations
from strainwave.presentation.report.correlations import Correlations


def parameter(name: str, value: float | None = 1.0, joint: int | None = 1) -> Parameter:
    return Parameter(name, joint, value, 0.1, "-", "tuned")


def correlations_of(names: list[str], covariance: list[list[float]]) -> Correlations | None:
    whole_arm = arm_model(tuple(parameter(name) for name in names), np.array(covariance))
    return correlations.correlations(replace(identification(), whole_arm=whole_arm))


def test_correlations_are_normalised_covariances() -> None:
    errors = correlations_of(["gear_stiffness", "gear_damping"], [[4.0, -5.88], [-5.88, 9.0]])
    assert errors is not None
    assert errors.names == ("gear stiffness 1", "gear damping 1")
    assert errors.matrix[0, 1] == pytest.approx(-0.98)
    ((first, second, size),) = correlations.strong_pairs(errors)
    assert (first, second) == errors.names
    assert size == pytest.approx(-0.98)
    assert "gear stiffness 1 and gear damping 1 (-0.980)" in correlations.describe(errors)
    (heat,) = marks(correlations.heat_map(errors), HeatMap)
    assert heat.names == errors.names
    assert heat.values[1] == pytest.approx([-0.98, 1.0])


def test_weak_correlations_are_not_listed() -> None:
    errors = correlations_of(["gear_stiffness", "gear_damping"], [[1.0, 0.9], [0.9, 1.0]])
    assert errors is not None
    assert correlations.strong_pairs(errors) == []
    assert "No two parameters have a correlation of 0.95 or more" in correlations.describe(errors)


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
    assert correlations.correlations(one) is None
    assert correlations.correlations(replace(one, rigid=None)) is None
