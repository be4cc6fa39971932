"""Which of three slopes the records show: none goes by another one's name."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain.gear_laws import gear_law

LAW = gear_law("three-slope")
K1, K2, K3, T1, T2 = LAW.names
CURVE = dict(zip(LAW.names, (8100.0, 11000.0, 13000.0, 4.0, 12.0), strict=True))


def known_by(largest: float = 30.0, **std: float) -> dict[str, str | None]:
    """By which estimate each parameter is known, of given relative deviations."""
    each = [CURVE[name] * std.get(name, 1e-3) for name in LAW.names]
    return dict(LAW.identified(CURVE, np.diag(each) ** 2, largest))


def test_what_is_well_known_is_known_by_its_own() -> None:
    assert known_by() == {name: name for name in LAW.names}


@pytest.mark.parametrize("std", [0.15, 1.0])
def test_the_better_known_slope_does_not_stand_for_a_vague_one(std: float) -> None:
    own = {name: name for name in LAW.names}
    assert known_by(**{K1: std}) == own | {K1: None, T1: None}
    assert known_by(**{K2: std}) == own | {K2: None, T1: None}


def test_the_last_slope_is_given_up_where_it_is_vague() -> None:
    assert known_by(**{K3: 0.3}) == {K1: K1, K2: K2, K3: None, T1: T1, T2: None}


def test_a_knee_beyond_all_torques_is_none() -> None:
    assert known_by(largest=10.0) == {K1: K1, K2: K2, K3: None, T1: T1, T2: None}


def test_a_knee_at_zero_is_none() -> None:
    values = CURVE | {T1: 0.1}
    each = np.array([values[name] for name in LAW.names]) * [0.5, 1e-3, 1e-3, 1e-3, 1e-3]
    found = LAW.identified(values, np.diag(each**2), 30.0)
    assert found == {K1: K2, K2: K3, K3: None, T1: T2, T2: None}


def test_slopes_that_are_one_are_known_by_the_better() -> None:
    values = CURVE | {K2: 1.002 * CURVE[K1]}
    each = np.array([values[name] for name in LAW.names]) * [5e-3, 1e-3, 1e-3, 1e-3, 1e-3]
    found = LAW.identified(values, np.diag(each**2), 30.0)
    assert found == {K1: K2, K2: K3, K3: None, T1: T2, T2: None}


def test_a_vague_slope_between_two_that_are_one_takes_no_value() -> None:
    values = CURVE | {K3: 1.002 * CURVE[K1]}
    each = np.array([values[name] for name in LAW.names]) * [2e-3, 0.3, 1e-3, 1e-3, 1e-3]
    found = LAW.identified(values, np.diag(each**2), 30.0)
    assert found == {K1: K3, K2: None, K3: None, T1: None, T2: None}


@pytest.mark.parametrize("knee", [4.0, 12.0])
def test_a_curve_that_lost_its_first_bend_starts_with_one_before(knee: float) -> None:
    lost = CURVE | {K1: CURVE[K2], K2: CURVE[K3], T1: knee, T2: 40.0}
    starts = list(LAW.restarts(lost, 30.0))
    before = [s for s in starts if s[T2] == knee]
    assert before
    assert all(s[K2] / s[K1] > 1.09 for s in before)
