"""Subspace method against SLICOT, if its Python package `ctrlsys` is installed."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.statespace._evaluate import Evaluator
from strainwave.statespace._scaled import stack
from strainwave.statespace.subspace import Factors, realise
from two_inertia import TwoInertia, excitation, simulate

HORIZON = 25


@pytest.mark.parametrize("samples", [512, 5000])
def test_inputs_and_feedthrough_agree_with_slicot(samples: int) -> None:
    """IB01CD fits B, D and the initial state for given A and C: the Markov parameters agree."""
    slicot = pytest.importorskip("ctrlsys", reason="SLICOT's ctrlsys is not installed")
    rng = np.random.default_rng(1)
    noise = np.array([0.3, 0.005]) * rng.standard_normal((samples, 2))
    start = np.array([1e-3, 5.0, 0.05])
    data = stack(simulate(TwoInertia().sampled(), excitation(rng, samples), noise, start))
    realisation, _ = realise(Factors(data), 3, "moesp", HORIZON, (True, True))
    ours = Evaluator(data, 3).linear(realisation, (True, True), gain=False, solutions=1)
    u, y = np.asfortranarray(data.inputs), np.asfortranarray(data.outputs)
    _, R, *_ = slicot.ib01ad("M", "C", "N", "O", "N", "N", HORIZON, 2, 2, u, y, 0.0, -1.0)
    A, C, B, D, *_ = slicot.ib01bd("M", "A", "K", HORIZON, 3, 2, 2, samples, R, 0.0)
    x, B, D, _, _, _, info = slicot.ib01cd("X", "C", "D", 3, 2, 2, A, B, C, D, u, y, 0.0)
    assert info == 0
    np.testing.assert_allclose(ours.D, D, rtol=1e-6, atol=1e-6 * np.abs(D).max())
    expected = markov(A, np.column_stack([B, x]), C)
    estimate = markov(ours.A, np.column_stack([ours.B, ours.initial_states[0]]), ours.C)
    # per column: inputs, and the response to the initial state
    size = np.abs(expected).max(axis=(0, 1))
    assert np.abs((estimate - expected) / size).max() < 1e-6


def markov(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Markov parameters C A^k B for k = 0 to 2 n, which are invariant to state coordinates."""
    powers = [np.linalg.matrix_power(A, k) for k in range(2 * len(A) + 1)]
    return np.stack([C @ power @ B for power in powers])


@pytest.mark.parametrize("samples", [512, 5000])
def test_moesp_agrees_with_slicot(samples: int) -> None:
    """IB01AD and IB01BD give the same singular values and poles."""
    slicot = pytest.importorskip("ctrlsys", reason="SLICOT's ctrlsys is not installed")
    rng = np.random.default_rng(0)
    gain = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
    noise = np.array([0.3, 0.005]) * rng.standard_normal((samples, 2))
    # Both use scaled channels, because output scales weight the singular value decomposition.
    data = stack(simulate(TwoInertia().sampled(gain), excitation(rng, samples), noise))
    ours, s = realise(Factors(data), 3, "moesp", HORIZON, (True, True))
    u, y = np.asfortranarray(data.inputs), np.asfortranarray(data.outputs)
    _, R, values, _, info = slicot.ib01ad(
        "M", "C", "N", "O", "N", "N", HORIZON, 2, 2, u, y, 0.0, -1.0
    )
    assert info == 0
    A, *_, info = slicot.ib01bd("M", "A", "K", HORIZON, 3, 2, 2, samples, R, 0.0)
    assert info == 0
    np.testing.assert_allclose(s[:10] / s[0], values[:10] / values[0], rtol=1e-8)
    np.testing.assert_allclose(poles(ours.A), poles(A), rtol=1e-8)


def poles(A: FloatArray) -> FloatArray:
    return np.asarray(np.sort_complex(np.linalg.eigvals(A)))
