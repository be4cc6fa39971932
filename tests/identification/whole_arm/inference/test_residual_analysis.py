"""Residual analysis: calibration of the tests on simulated series and on virtual arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from effect_runs import ALL, SIZES, whole_arm
from strainwave.domain import EffectName, FloatArray, ResidualTest
from strainwave.identification.whole_arm.inference.fit_tests import (
    InputCorrelation,
    has_noise_spectrum,
    residual_warnings,
    spectral_density,
    strongest_input,
)
from strainwave.identification.whole_arm.inference.score_tests import least_squares
from strainwave.identification.whole_arm.problem.effect_unknowns import sizes_of
from strainwave.identification.whole_arm.records.dataset import low_pass_kernels
from strainwave.numerics.spectra import correlate_residuals

T = 1e-3
KERNELS = low_pass_kernels(60.0, T)
ROW = KERNELS.step * T


def behind(noise: FloatArray) -> FloatArray:
    return KERNELS.rows(noise, slope=False)


def test_a_spectral_density_is_welchs() -> None:
    x = np.random.default_rng(0).normal(size=1440)
    frequency, density = spectral_density(x, T)
    f, expected = signal.welch(x, 1.0 / T, "hann", 320)
    np.testing.assert_allclose(frequency, f)
    np.testing.assert_allclose(density[1:-1], expected[1:-1], rtol=1e-9)


def test_noise_has_the_colour_of_noise() -> None:
    """The p-values of white noise are uniform."""
    rng = np.random.default_rng(1)
    p_values = [
        has_noise_spectrum(behind(rng.normal(size=3000)), ROW, KERNELS.smooth, T, 48.0)
        for _ in range(400)
    ]
    for level in (0.05, 0.1):
        standard_error = np.sqrt(level * (1.0 - level) / len(p_values))
        assert np.mean(np.array(p_values) < level) == pytest.approx(level, abs=3.0 * standard_error)
    assert np.median(p_values) == pytest.approx(0.5, abs=0.15)


def test_a_forgotten_mode_has_another_colour() -> None:
    rng = np.random.default_rng(2)
    ringing = signal.lfilter([1.0], [1.0, -1.95, 0.96], rng.normal(size=3000))
    residual = behind(rng.normal(size=3000) + 0.3 * ringing / np.std(ringing))
    assert has_noise_spectrum(residual, ROW, KERNELS.smooth, T, 48.0) < 1e-3


def by_input(residual: FloatArray, inputs: FloatArray) -> InputCorrelation:
    return strongest_input(correlate_residuals(residual, inputs, ROW))


def test_residuals_independent_of_inputs_have_no_input_correlation() -> None:
    rng = np.random.default_rng(3)
    p_values = []
    for _ in range(300):
        inputs = np.column_stack([behind(rng.normal(size=3000)) for _ in range(2)])
        p_values.append(by_input(behind(rng.normal(size=3000)), inputs).probability)
    # the p-value for all delays together is conservative
    assert np.mean(np.array(p_values) < 0.05) < 0.05 + 3.0 * np.sqrt(0.05 / 300.0)


@pytest.mark.parametrize("delay", [0, 3, 9])
def test_an_input_correlation_gives_the_input_and_the_delay(delay: int) -> None:
    rng = np.random.default_rng(4)
    inputs = np.column_stack([behind(rng.normal(size=6000)) for _ in range(2)])
    residual = rng.normal(size=len(inputs)) * np.std(inputs)
    residual[delay:] -= 0.5 * inputs[: len(inputs) - delay, 1]
    strongest = by_input(residual, inputs)
    assert strongest.joint == 2
    assert strongest.correlation < -0.2
    assert strongest.delay == pytest.approx(delay * ROW, abs=0.1 * ROW)
    assert strongest.probability < 1e-6


def test_a_constant_channel_has_no_input_correlation() -> None:
    strongest = by_input(np.zeros(100), np.ones((100, 2)))
    assert (strongest.correlation, strongest.probability) == (0.0, 1.0)
    assert has_noise_spectrum(np.zeros(100), ROW, KERNELS.smooth, T, 48.0) == 1.0


def left_over(channel: str, deviation: float, odds: float) -> ResidualTest:
    zeros = np.zeros(2)
    return ResidualTest(
        "prbs", channel, deviation, 1.0, zeros, zeros, zeros, 21.0, 0.5, 2, 0.4, 0.004, odds
    )


def test_only_residuals_far_above_the_noise_have_a_warning() -> None:
    tests = [left_over("a1", 2.0, 1e-9), left_over("a2", 5.0, 1e-9), left_over("a2", 4.0, 0.5)]
    (warning,) = residual_warnings(tests, explained=True)
    assert warning.code == "residual-not-noise"
    assert "a2 are 5 times" in warning.message
    assert "near 21 Hz" in warning.message
    assert "joint 2's input by 4 ms" in warning.message
    (unexplained,) = residual_warnings([replace(tests[1], input_probability=0.5)], explained=False)
    assert "none of the effects that the program knows" in unexplained.message
    assert "none of the effects" not in warning.message
    assert "without linear dependence on an input" in unexplained.message


@pytest.mark.parametrize("effect", ALL)
def test_an_effect_that_is_not_in_the_model_is_named(effect: EffectName) -> None:
    """The effect ranks first with its size, and the warning states the remedy."""
    model = whole_arm((effect,), ())
    assert model.criticism is not None
    first = model.criticism.causes[0]
    assert (first.joint, first.effect) == (1, effect)
    sizes = {p.key: p for p in first.parameters}
    for key in sizes_of((1, effect)):
        size, std = sizes[key].value, sizes[key].std
        assert size == pytest.approx(SIZES[key], rel=0.1)
        assert std is not None
        assert std < 0.1 * abs(SIZES[key])
    warning = {c.code: c for c in model.warnings}[f"{effect}-likely"]
    assert warning.where == "joint 1"
    assert f'effects = ["{effect}"]' in warning.message


@pytest.mark.parametrize(
    ("signed", "true", "expected"),
    [
        ((True, True), (-2.0, 3.0), (-2.0, 3.0)),
        ((False, True), (2.0, -3.0), (2.0, -3.0)),
        ((False, True), (-2.0, 3.0), (0.0, 1.0)),
        ((False, False), (-2.0, 3.0), (0.0, 1.0)),
        ((False,), (-2.0,), (0.0,)),
    ],
)
def test_sizes_without_sign_are_not_negative(
    signed: tuple[bool, ...], true: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    columns = np.array([[1.0, 1.0], [1.0, 0.0]])[:, : len(signed)]
    target = -columns @ true
    np.testing.assert_allclose(least_squares(columns, target, np.array(signed)), expected)


def test_an_arm_without_effects_gives_no_evidence_of_any() -> None:
    model = whole_arm((), ())
    assert model.criticism is not None
    assert model.criticism.causes == ()
    assert not any(c.code.endswith("-likely") for c in model.warnings)


def test_fitted_effects_are_not_candidates() -> None:
    model = whole_arm(("hysteresis",), ("hysteresis",))
    assert model.criticism is not None
    assert model.criticism.causes == ()
