"""Low-pass and differentiating kernels of the whole-arm fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.identification.whole_arm.records.low_pass import low_pass_kernels


@given(
    cutoff=st.floats(20.0, 150.0),
    sample_time=st.sampled_from([2.5e-4, 5e-4, 1e-3]),
    ahead=st.floats(-0.5, 0.5),
)
def test_velocities_of_advanced_rows(cutoff: float, sample_time: float, ahead: float) -> None:
    """Whatever the advance, a motor at rest far from zero has no velocity and a ramp its own."""
    kernels = low_pass_kernels(cutoff, sample_time, ahead)
    t = sample_time * np.arange(float(len(kernels.slope) + 8 * kernels.step))
    assert kernels.rows(np.full(len(t), 300.0), slope=True) == pytest.approx(0.0, abs=1e-9)
    ramp = np.asarray(300.0 + 7.0 * t)
    assert kernels.rows(ramp, slope=True) == pytest.approx(7.0, rel=1e-9)
    assert kernels.rows(np.full(len(t), 300.0), slope=False) == pytest.approx(300.0)
