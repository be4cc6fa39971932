"""Welch's method against SciPy, and against the known density of white noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from strainwave.numerics.spectra import Trend, cross_spectral_densities, window_spectra

T = 1e-3


@pytest.mark.parametrize(("trend", "detrend"), [("mean", "constant"), ("line", "linear")])
@pytest.mark.parametrize("segment", [128, 129])
def test_densities_are_scipys(trend: Trend, detrend: str, segment: int) -> None:
    x = np.cumsum(np.random.default_rng(0).normal(size=(1000, 2)), axis=0)
    frequency, density = cross_spectral_densities(x, T, segment, trend=trend)
    overlap = segment // 2
    for i in range(2):
        for j in range(2):
            f, expected = signal.csd(
                x[:, i], x[:, j], 1.0 / T, "hann", segment, overlap, detrend=detrend
            )
            np.testing.assert_allclose(frequency, f)
            np.testing.assert_allclose(density[:, i, j], expected, rtol=1e-9, atol=1e-15)


def test_the_density_of_white_noise_is_its_variance_over_the_band() -> None:
    x = 3.0 * np.random.default_rng(1).normal(size=(200_000, 1))
    frequency, density = cross_spectral_densities(x, T, 256)
    area = float(np.sum(density[1:, 0, 0].real) * frequency[1])
    assert area == pytest.approx(9.0, rel=0.02)


def test_windows_begin_every_few_samples() -> None:
    x = np.arange(20.0)[:, None]
    spectra = window_spectra(x, np.ones(8), 4)
    assert spectra.shape == (4, 5, 1)
    np.testing.assert_allclose(spectra[:, 0], 0.0, atol=1e-12)  # the mean is removed
    np.testing.assert_allclose(spectra[2, :, 0], np.fft.rfft(x[8:16, 0] - x[8:16, 0].mean()))
