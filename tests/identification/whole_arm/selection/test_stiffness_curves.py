"""Restarts for gear curves that have lost a knee."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from strainwave.domain.arm.gear_laws import KNEES, SLOPES, ThreeSlope
from strainwave.domain.keys import Values
from strainwave.identification.whole_arm.selection.gear_laws import alternative_curves

LAW, LARGEST = ThreeSlope(), 40.0
NAMES = (*SLOPES, *KNEES)


def curve(*numbers: float) -> Values:
    other_values: Values = {("motor_inertia", 1): 1e-4, **{(name, 2): 1.0 for name in NAMES}}
    return other_values | {(name, 1): value for name, value in zip(NAMES, numbers, strict=True)}


def torque(values: Values, torsion: float) -> float:
    k1, k2, k3, t1, t2 = (values[name, 1] for name in NAMES)
    d1 = t1 / k1
    d2 = d1 + (t2 - t1) / k2
    return float(np.interp(torsion, [0.0, d1, d2, d2 + 1.0], [0.0, t1, t2, t2 + k3]))


def test_a_curve_that_bends_twice_is_left_alone() -> None:
    assert list(alternative_curves(LAW, curve(1e4, 1.5e4, 2e4, 5.0, 20.0), 1, LARGEST)) == []


@pytest.mark.parametrize(
    "lost",
    [
        curve(1e4, 1.5e4, 9e4, 8.0, 90.0),  # second knee out of range
        curve(1e4, 1.5e4, 1.5e4, 8.0, 20.0),  # second and third slope equal
        curve(3e4, 1e4, 1.5e4, 0.1, 8.0),  # first knee at zero
        curve(1e4, 1e4, 1.5e4, 3.0, 8.0),  # first and second slope equal
        curve(1e4, 1.2e4, 1.5e4, 7.5, 8.5),  # knees nearly equal
    ],
)
def test_one_bend_is_split(lost: Values) -> None:
    """Three starts near the estimated curve, with increasing, reachable knees."""
    starts = list(alternative_curves(LAW, lost, 1, LARGEST))
    assert len(starts) == 3
    for start in starts:
        assert 0.0 < start[KNEES[0], 1] < start[KNEES[1], 1] < LARGEST
        slopes = [start[name, 1] for name in SLOPES]
        assert all(abs(b / a - 1.0) > 0.01 for a, b in pairwise(slopes))
        for torsion in (4e-4, 1.5e-3):
            assert torque(start, torsion) == pytest.approx(torque(lost, torsion), rel=0.1)
        assert {k: v for k, v in start.items() if k[1] == 2 or k[0] not in NAMES} == {
            k: v for k, v in lost.items() if k[1] == 2 or k[0] not in NAMES
        }


def test_no_bend_is_sought_low_and_high() -> None:
    starts = list(alternative_curves(LAW, curve(1e4, 1e4, 1e4, 5.0, 20.0), 1, LARGEST))
    assert len(starts) == 2
    assert starts[0][KNEES[1], 1] <= starts[1][KNEES[0], 1]
