"""The subspace step against SLICOT's, where its Python package `ctrlsys` is installed."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.records import FloatArray
from strainwave.statespace._stack import stack
from strainwave.statespace.subspace import realise
from two_inertia import TwoInertia, excitation, simulate

HORIZON = 25


@pytest.mark.parametrize("samples", [512, 5000])
def test_moesp_agrees_with_slicot(samples: int) -> None:
    """IB01AD and IB01BD find the same subspace: the same singular values and poles."""
    slicot = pytest.importorskip("ctrlsys", reason="SLICOT's ctrlsys is not installed")
    rng = np.random.default_rng(0)
    gain = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
    noise = np.array([0.3, 0.005]) * rng.standard_normal((samples, 2))
    # Scaled channels for both, as output scales weigh the singular value decomposition.
    data = stack(simulate(TwoInertia().sampled(gain), excitation(rng, samples), noise))
    ours = realise(data, 3, "moesp", HORIZON, (True, True))
    u, y = np.asfortranarray(data.inputs), np.asfortranarray(data.outputs)
    _, R, values, _, info = slicot.ib01ad(
        "M", "C", "N", "O", "N", "N", HORIZON, 2, 2, u, y, 0.0, -1.0
    )
    assert info == 0
    A, *_, info = slicot.ib01bd("M", "A", "K", HORIZON, 3, 2, 2, samples, R, 0.0)
    assert info == 0
    s = ours.singular_values[:10]
    np.testing.assert_allclose(s / s[0], values[:10] / values[0], rtol=1e-8)
    np.testing.assert_allclose(poles(ours.matrices.A), poles(A), rtol=1e-8)


def poles(A: FloatArray) -> FloatArray:
    return np.asarray(np.sort_complex(np.linalg.eigvals(A)))
