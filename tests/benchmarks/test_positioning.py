"""The box of the published two-inertia benchmark."""

from __future__ import annotations

import numpy as np
from benchmarks.studies.positioning import REQUIRED_SECONDS, box, design


def test_the_box_has_its_middle_and_corners() -> None:
    plants = box(3)
    assert len(plants) == 1 + 4 + 3
    stiffness = np.array([plant["gear_stiffness", 1] for plant in plants])
    assert stiffness[0] == 0.013
    np.testing.assert_allclose([stiffness.min(), stiffness.max()], [0.00975, 0.01625])
    damping = np.array([plant["gear_damping", 1] for plant in plants])
    np.testing.assert_allclose([damping.min(), damping.max()], [2.5e-7, 7.5e-7])


def test_the_load_settles_in_time_for_the_whole_box() -> None:
    result = design(20)
    assert len(result.steps.settling) == 25
    assert result.steps.settling.max() < REQUIRED_SECONDS
    assert result.margins.gain_db.min() >= 6.0
    assert result.margins.phase_deg.min() >= 30.0
