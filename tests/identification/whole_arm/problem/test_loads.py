"""Gear load: the largest torque of all records, and the load distribution."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.identification.whole_arm.conclusion import histograms_of
from strainwave.identification.whole_arm.problem.starting_values import largest_of


def test_the_largest_is_that_of_any_record_but_for_rare_samples() -> None:
    calm = np.full((5000, 2), 1.0)
    lively = np.column_stack([np.full(5000, 3.0), np.full(5000, 0.5)])
    lively[0] = 100.0  # one sample in 5000
    assert largest_of([calm, lively]).tolist() == [3.0, 1.0]


def test_shares_are_of_all_samples_whatever_their_record() -> None:
    first, second = np.full((100, 1), 0.1), np.full((300, 1), 6.0)
    (load,) = histograms_of([first, second])
    assert load.joint == 1
    assert (load.edges[0], load.edges[-1]) == (0.0, 6.0)
    assert len(load.edges) == len(load.share) + 1
    assert load.share.sum() == pytest.approx(1.0)
    assert (load.share[1], load.share[-1]) == (0.25, 0.75)
