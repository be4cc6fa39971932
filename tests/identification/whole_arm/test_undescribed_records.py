"""Records that a fit does not describe."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from strainwave.identification.whole_arm.search import (
    are_exceptions,
    find_undescribed,
)

SIGNAL = np.column_stack([np.sin(np.arange(400.0)), np.cos(np.arange(400.0))])
RNG = np.random.default_rng(0)


def fit_with(errors: list[float], noise: float = 1e-3) -> Any:
    """A fit of two-channel records with these residuals of the second channel."""
    record = SimpleNamespace(measured=SIGNAL, noise=np.full(2, noise))
    rows = [
        SimpleNamespace(errors=RNG.normal(size=SIGNAL.shape) * [1e-3, error]) for error in errors
    ]
    objective = SimpleNamespace(records=[record] * len(errors), rows=lambda _: rows)
    return SimpleNamespace(objective=objective, z=np.zeros(1))


def test_a_residual_far_above_noise_and_of_the_size_of_the_signal_is_not_described() -> None:
    assert find_undescribed(fit_with([1e-3, 0.3, 0.02, 0.2])) == [1, 3]


def test_noise_is_described() -> None:
    assert find_undescribed(fit_with([0.3, 0.3], noise=0.1)) == []


@pytest.mark.parametrize(("count", "expected"), [(0, False), (1, True), (2, True), (3, False)])
def test_a_fit_that_describes_few_records_has_a_wrong_model(count: int, expected: bool) -> None:
    fit = fit_with([1e-3] * 8)
    assert are_exceptions(list(range(count)), fit) is expected
