"""Estimates of fits whose derivatives diverge."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from strainwave.identification.whole_arm.inference import parameter_estimates as module

VALUES = np.array([2.0, -3e-5, 0.0])


def fit_with(stds: list[float], monkeypatch: pytest.MonkeyPatch) -> Any:
    """A fit of two records, of which the second has by far the largest derivatives."""
    confidence = SimpleNamespace(combined=np.diag(np.square(stds)))
    monkeypatch.setattr(module, "confidence_of", lambda _: confidence)
    columns = np.ones((5, 2, 3))
    evaluations = [SimpleNamespace(columns=factor * columns) for factor in (1e3, 1e18)]
    return SimpleNamespace(
        z=np.zeros(3),
        space=SimpleNamespace(parameters=lambda _: VALUES),
        records=["prbs-j1", "step-j2"],
        objective=SimpleNamespace(evaluate=lambda _: evaluations),
    )


def test_a_standard_deviation_that_no_record_can_give_names_the_record(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert module.diverging_record(fit_with([1e-3, 1e-20, 1e-3], monkeypatch)) == "step-j2"


def test_small_standard_deviations_and_a_value_of_zero_are_trusted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert module.diverging_record(fit_with([1e-8, 1e-13, 0.0], monkeypatch)) is None
