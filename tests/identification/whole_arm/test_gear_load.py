"""What gears carry: the largest torque of all records, and how often which."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.identification.whole_arm.gear_load import histograms_of, largest_of


def test_the_largest_is_that_of_any_record_but_for_rare_samples() -> None:
    calm = np.full((5000, 2), 1.0)
    lively = np.column_stack([np.full(5000, 3.0), np.full(5000, 0.5)])
    lively[0] = 100.0  # one sample in five thousand
    assert largest_of([calm, lively]).tolist() == [3.0, 1.0]


def test_shares_are_of_all_samples_whatever_their_record() -> None:
    first, second = np.full((100, 1), 0.1), np.full((300, 1), 6.0)
    (found,) = histograms_of([first, second])
    assert found.joint == 1
    assert (found.edges[0], found.edges[-1]) == (0.0, 6.0)
    assert len(found.edges) == len(found.share) + 1
    assert found.share.sum() == pytest.approx(1.0)
    assert (found.share[1], found.share[-1]) == (0.25, 0.75)
