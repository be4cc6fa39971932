"""Identifiable slopes and knees of a three-slope law."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain.arm.gear_laws import gear_law

LAW = gear_law("three-slope")
K1, K2, K3, T1, T2 = LAW.names
CURVE = dict(zip(LAW.names, (8100.0, 11000.0, 13000.0, 4.0, 12.0), strict=True))


def identified_for(largest: float = 30.0, **std: float) -> dict[str, str | None]:
    """Representing estimates for given relative standard deviations."""
    each = [CURVE[name] * std.get(name, 1e-3) for name in LAW.names]
    return dict(LAW.identified(CURVE, np.diag(each) ** 2, largest))


def test_precise_parameters_represent_themselves() -> None:
    assert identified_for() == {name: name for name in LAW.names}


@pytest.mark.parametrize("std", [0.15, 1.0])
def test_an_imprecise_slope_is_not_identified(std: float) -> None:
    identity = {name: name for name in LAW.names}
    assert identified_for(**{K1: std}) == identity | {K1: None, T1: None}
    assert identified_for(**{K2: std}) == identity | {K2: None, T1: None}


def test_an_imprecise_last_slope_is_not_identified() -> None:
    assert identified_for(**{K3: 0.3}) == {K1: K1, K2: K2, K3: None, T1: T1, T2: None}


def test_a_knee_beyond_all_torques_is_not_identified() -> None:
    assert identified_for(largest=10.0) == {K1: K1, K2: K2, K3: None, T1: T1, T2: None}


def test_a_knee_at_zero_is_removed() -> None:
    values = CURVE | {T1: 0.1}
    each = np.array([values[name] for name in LAW.names]) * [0.5, 1e-3, 1e-3, 1e-3, 1e-3]
    estimates = LAW.identified(values, np.diag(each**2), 30.0)
    assert estimates == {K1: K2, K2: K3, K3: None, T1: T2, T2: None}


@pytest.mark.parametrize(
    ("std", "k1"),
    [(1.2, K2), (0.5, None)],  # of the knee; the slope above the knee is determined, as k1 or as k2
)
def test_a_knee_that_may_be_zero_is_removed(std: float, k1: str | None) -> None:
    estimates = identified_for(**{K1: 0.5, T1: std})
    assert estimates[K1] == k1
    assert estimates[T1] == (T2 if k1 else None)


def test_a_precise_slope_stays_although_its_knee_may_be_zero() -> None:
    assert identified_for(**{K2: 0.5, T1: 1.2})[K1] == K1


def test_a_small_knee_that_the_data_determine_stays() -> None:
    values = CURVE | {T1: 0.1}
    each = 1e-3 * np.array([values[name] for name in LAW.names])
    estimates = LAW.identified(values, np.diag(each**2), 30.0)
    assert estimates == {name: name for name in LAW.names}


def test_close_knees_are_one() -> None:
    """A gear with one knee within the records: the slope beyond it is the second one."""
    values = CURVE | {T2: 1.1 * CURVE[T1]}
    each = 1e-3 * np.array([values[name] for name in LAW.names])
    estimates = LAW.identified(values, np.diag(each**2), 30.0)
    assert estimates == {K1: K1, K2: K3, K3: None, T1: T1, T2: None}


def test_the_more_precise_of_equal_slopes_represents_both() -> None:
    values = CURVE | {K2: 1.002 * CURVE[K1]}
    each = np.array([values[name] for name in LAW.names]) * [5e-3, 1e-3, 1e-3, 1e-3, 1e-3]
    estimates = LAW.identified(values, np.diag(each**2), 30.0)
    assert estimates == {K1: K2, K2: K3, K3: None, T1: T2, T2: None}


def test_an_imprecise_slope_between_equal_slopes_is_not_identified() -> None:
    values = CURVE | {K3: 1.002 * CURVE[K1]}
    each = np.array([values[name] for name in LAW.names]) * [2e-3, 0.3, 1e-3, 1e-3, 1e-3]
    estimates = LAW.identified(values, np.diag(each**2), 30.0)
    assert estimates == {K1: K3, K2: None, K3: None, T1: None, T2: None}


@pytest.mark.parametrize("knee", [4.0, 12.0])
def test_restarts_add_a_lower_knee(knee: float) -> None:
    degenerate = CURVE | {K1: CURVE[K2], K2: CURVE[K3], T1: knee, T2: 40.0}
    starts = list(LAW.restarts(degenerate, 30.0))
    before = [s for s in starts if s[T2] == knee]
    assert before
    assert all(s[K2] / s[K1] > 1.09 for s in before)
