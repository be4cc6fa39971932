"""Ranking of input shapers over modes that vary."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.tune.shapers import (
    Impulses,
    RankedShaper,
    ShaperKind,
    design_shaper,
    rank_shapers,
)

PERIOD = 1e-3


def drawn(hz: float, spread: float, n: int = 60) -> tuple[FloatArray, FloatArray]:
    """Frequencies in equal steps within +- spread, with little damping that rises with them."""
    omega = 2.0 * np.pi * hz * np.linspace(1.0 - spread, 1.0 + spread, n)
    return omega, np.linspace(0.02, 0.03, n)


def kinds_of(candidate: RankedShaper) -> tuple[ShaperKind, ...]:
    return tuple(shaper.kind for shaper in candidate.shapers)


@settings(deadline=None, max_examples=10)
@given(st.floats(3.0, 60.0), st.floats(0.0, 0.3), st.floats(0.01, 0.2))
def test_order_follows_the_rule(hz: float, spread: float, required: float) -> None:
    ranked = rank_shapers(*drawn(hz, spread), PERIOD, required)
    assert {kinds_of(candidate) for candidate in ranked} == {(kind,) for kind in ShaperKind}
    sufficient = [r for r in ranked if r.is_sufficient]
    assert ranked[: len(sufficient)] == sufficient
    durations = [r.impulses.duration for r in sufficient]
    assert durations == sorted(durations)
    others = [r.vibration for r in ranked[len(sufficient) :]]
    assert others == sorted(others)
    assert all((r.vibration <= required) == r.is_sufficient for r in ranked)


def test_larger_spread_needs_longer_shapers() -> None:
    best = [rank_shapers(*drawn(8.0, spread), PERIOD)[0] for spread in (0.0, 0.05, 0.15, 0.3)]
    assert all(r.is_sufficient for r in best)
    assert [kinds_of(r)[0] for r in best] == [
        ShaperKind.ZV,
        ShaperKind.MZV,
        ShaperKind.EI,
        ShaperKind.TWO_HUMP_EI,
    ]


def test_vibration_is_the_worst_of_the_interval_and_least_over_design_frequencies() -> None:
    omega, damping = drawn(8.0, 0.12, 401)
    inside = slice(10, -10)  # the central 95 % of equal steps
    for candidate in rank_shapers(omega, damping, PERIOD):
        shares = candidate.impulses.residual_vibration(omega[inside], damping[inside])
        assert shares.max() == pytest.approx(candidate.vibration, rel=0.02)  # 10 of 401 steps
        (shaper,) = candidate.shapers
        middle = np.median(omega)
        if shaper.kind in (ShaperKind.ZV, ShaperKind.MZV, ShaperKind.ZVD):
            for other in np.linspace(0.9, 1.1, 41) * middle:
                sampled = design_shaper(shaper.kind, other, shaper.damping).sample(PERIOD)
                shares = sampled.residual_vibration(omega[inside], damping[inside])
                assert shares.max() >= candidate.vibration * (1.0 - 0.02)


def test_tolerance_of_extra_insensitive_shapers_suits_the_interval() -> None:
    omega, damping = drawn(8.0, 0.12, 401)
    by_kind = {kinds_of(r)[0]: r for r in rank_shapers(omega, damping, PERIOD)}
    for kind in (ShaperKind.EI, ShaperKind.TWO_HUMP_EI):
        at = by_kind[kind].shapers[0]
        default = design_shaper(kind, at.omega, at.damping).sample(PERIOD)
        assert by_kind[kind].vibration < default.residual_vibration(omega, damping).max()


def test_interval_ignores_the_tails_of_draws() -> None:
    omega, damping = drawn(8.0, 0.02, 400)
    outliers = omega.copy()
    outliers[:5], outliers[-5:] = 0.5 * omega[0], 2.0 * omega[-1]
    plain, tailed = (rank_shapers(w, damping, PERIOD)[0] for w in (omega, outliers))
    assert kinds_of(plain) == kinds_of(tailed)
    assert plain.vibration == pytest.approx(tailed.vibration, rel=0.02)


def test_interval_includes_frequencies_between_draws() -> None:
    ends = np.repeat(2.0 * np.pi * np.array([5.0, 15.0]), 10)  # a ZV shaper has zeros at both
    ranked = rank_shapers(ends, np.zeros(20), PERIOD)
    assert not any(r.is_sufficient for r in ranked)


def test_several_modes_share_the_convolution() -> None:
    modes = [drawn(6.0, 0.02), drawn(9.5, 0.02)]
    omega, damping = np.array([w for w, _ in modes]), np.array([z for _, z in modes])
    ranked = rank_shapers(omega, damping, PERIOD)
    assert len(ranked) == 6 * 6 - 1
    first = ranked[0]
    assert first.is_sufficient
    weights = np.ones(1)
    for shaper in first.shapers:
        weights = np.convolve(weights, shaper.sample(PERIOD).amplitudes)
    np.testing.assert_allclose(first.impulses.amplitudes, weights, atol=1e-15)
    both = Impulses(weights, PERIOD * np.arange(len(weights), dtype=float))
    assert both.residual_vibration(omega, damping).max() < 1.1 * 0.05  # including the tails
    alone = rank_shapers(omega[0], damping[0], PERIOD)[0]
    assert first.impulses.duration > alone.impulses.duration


def test_one_shaper_serves_modes_of_threefold_frequency() -> None:
    hz = np.array([[5.0], [15.0]])  # the zeros of a ZV shaper are at odd multiples
    first = rank_shapers(2.0 * np.pi * hz, np.zeros((2, 1)), PERIOD)[0]
    assert len(first.shapers) == 1
    assert first.vibration < 0.01


def test_fast_decay_leaves_out_extra_insensitive_shapers() -> None:
    ranked = rank_shapers(np.full(3, 30.0), np.full(3, 0.95), PERIOD)
    assert {kinds_of(r)[0] for r in ranked} == {ShaperKind.ZV, ShaperKind.MZV, ShaperKind.ZVD}


@pytest.mark.parametrize(
    ("omega", "damping", "message"),
    [
        ([30.0, 0.0], [0.1, 0.1], "frequency 0 rad/s"),
        ([30.0, 40.0], [0.1, 1.2], "damping ratio 1.2 does not oscillate"),
        ([-3.0], [0.1], "frequency -3 rad/s of a mode is not positive"),
        ([np.nan], [0.1], "frequency nan rad/s of a mode is not positive and finite"),
        ([np.inf], [0.1], "frequency inf rad/s of a mode is not positive and finite"),
        ([3.0], [1.0], "damping ratio 1 does not oscillate"),
        ([3.0], [-0.1], "damping ratio -0.1 does not oscillate"),
        ([3.0], [np.nan], "damping ratio nan does not oscillate"),
        ([4000.0], [0.1], "but half of the sampling rate is 500 Hz"),
    ],
)
def test_refuses(omega: list[float], damping: list[float], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        rank_shapers(np.array(omega), np.array(damping), PERIOD)
