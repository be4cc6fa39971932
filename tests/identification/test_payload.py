"""Parts of the fit of a load."""

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.identification.payload import _shrunk


def correlations(rows: FloatArray) -> FloatArray:
    return np.asarray(np.corrcoef(rows, rowvar=False), dtype=np.float64)


def test_correlations_by_chance_are_removed() -> None:
    """20 draws of 60 independent variables have correlations of chance, and rank 19."""
    rows = np.random.default_rng(1).normal(size=(20, 60))
    shrunk = _shrunk(correlations(rows))
    assert np.abs(shrunk - np.eye(60)).max() < 0.2
    assert np.linalg.eigvalsh(shrunk)[0] > 0.5


def test_correlations_of_a_common_cause_stay() -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(20, 1)) + 0.1 * rng.normal(size=(20, 30))
    assert _shrunk(correlations(rows)) == pytest.approx(np.ones((30, 30)), abs=0.05)


def test_independent_parameters_are_unchanged() -> None:
    np.testing.assert_array_equal(_shrunk(np.eye(4)), np.eye(4))
