"""Residual correlations: known delays, and confidence limits for coloured noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from strainwave.numerics.spectra import (
    MAX_LAGS,
    correlate_residuals,
    expected_autocorrelation,
)

N = 2000


def test_a_delayed_input_gives_a_peak_at_its_delay() -> None:
    u = np.random.default_rng(0).standard_normal((N, 1))
    residual = np.concatenate([np.zeros(7), u[:-7, 0]])
    correlation = correlate_residuals(residual, u, 1e-3)
    cross = correlation.cross_correlation[:, 0]
    assert np.argmax(cross) == MAX_LAGS + 7
    assert cross.max() == pytest.approx(1.0, abs=0.01)
    assert correlation.lag_time == 1e-3
    assert correlation.n_samples == N


def test_values_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(1)
    e, u = rng.standard_normal((2, 60))
    correlation = correlate_residuals(e, u[:, None], 1.0)
    e, u = e - e.mean(), u - u.mean()
    lags = len(correlation.autocorrelation) - 1
    assert lags == 15  # a quarter of the samples
    for lag in range(1, lags + 1):
        assert correlation.autocorrelation[lag] == pytest.approx(e[lag:] @ e[:-lag] / (e @ e))
        scale = np.sqrt((e @ e) * (u @ u))
        behind, ahead = e[lag:] @ u[:-lag] / scale, e[:-lag] @ u[lag:] / scale
        assert correlation.cross_correlation[lags + lag, 0] == pytest.approx(behind)
        assert correlation.cross_correlation[lags - lag, 0] == pytest.approx(ahead)


def test_the_standard_deviation_holds_for_coloured_signals() -> None:
    """The scatter of independent low-pass noise equals the reported standard deviation."""
    rng = np.random.default_rng(2)
    values, reported_std = [], []
    for _ in range(400):
        e, u = (lfilter([1.0], [1.0, -0.9], rng.standard_normal(N)) for _ in range(2))
        correlation = correlate_residuals(e, u[:, None], 1.0)
        values.append(correlation.cross_correlation[:, 0])
        reported_std.append(correlation.cross_std[0])
    # the variance for two first-order processes is (1 + a^2) / (1 - a^2) times that for white noise
    assert np.mean(reported_std) == pytest.approx(np.sqrt(1.81 / 0.19 / N), rel=0.15)
    # 400 draws: standard error of 4 %.
    assert np.std(values) == pytest.approx(np.mean(reported_std), rel=0.15)


def test_a_constant_signal_has_no_correlation() -> None:
    correlation = correlate_residuals(np.ones(100), np.zeros((100, 2)), 1.0)
    assert not correlation.autocorrelation.any()
    assert not correlation.cross_correlation.any()
    assert np.isfinite(correlation.cross_std).all()


def test_the_autocorrelation_of_a_density_and_its_scatter() -> None:
    """For first-order noise, rho(l) = a^|l|, and estimates have the reported standard deviation."""
    a, f = 0.7, np.linspace(0.0, 0.5, 2001)
    density = 1.0 / np.abs(1.0 - a * np.exp(-2j * np.pi * f)) ** 2
    rho, std = expected_autocorrelation(f, density, 1.0, 10, N)
    # the sum over frequencies weights its ends twice: an error of half a line in 2000
    assert rho == pytest.approx(a ** np.arange(11.0), abs=2e-3)
    rng = np.random.default_rng(3)
    estimates = [
        correlate_residuals(
            lfilter([1.0], [1.0, -a], rng.standard_normal(N)), np.zeros((N, 0)), 1.0
        ).autocorrelation[:11]
        for _ in range(400)
    ]
    assert std[0] == pytest.approx(0.0, abs=1e-6)
    assert np.std(estimates, axis=0)[1:] == pytest.approx(std[1:], rel=0.15)
