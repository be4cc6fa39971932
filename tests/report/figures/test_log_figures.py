"""Figures of logs: decimation, spectra, coherence, units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from signal_logs import T, log_with, motors
from strainwave.domain import Log
from strainwave.report.figures.log_figures import (
    ShownRecord,
    View,
    coherence_figure,
    spectrum_figure,
    time_figure,
)
from strainwave.virtual import scara


def view_of(folder: Path, log: Log, *channels: str, **choices: Any) -> View:
    arm = scara.STIFF.study(folder).arm
    return View([ShownRecord("one", [log])], channels, arm, **choices)


def test_a_million_points_are_few_and_keep_their_peaks(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=1_000_000)
    values[123_456], values[654_321] = 50.0, -60.0
    log = log_with({"a1": values, **motors(1_000_000)})
    (panel,) = time_figure(view_of(tmp_path, log, "a1"), (0.0, 1000.0), 1500).panels
    drawn: Any = panel.marks[0]
    assert len(drawn.x) <= 1500
    assert (drawn.y.min(), drawn.y.max()) == (-60.0, 50.0)


def test_a_zoom_shows_every_sample(tmp_path: Path) -> None:
    log = log_with(motors(100_000))
    (panel,) = time_figure(view_of(tmp_path, log, "u1"), (10.0, 10.5), 1500).panels
    drawn: Any = panel.marks[0]
    assert 501 <= len(drawn.x) <= 504
    assert drawn.x[0] <= 10.0
    assert drawn.x[-1] >= 10.5


def test_the_spectrum_of_a_sine_has_its_peak_and_power(tmp_path: Path) -> None:
    time = T * np.arange(60_000)
    log = log_with({"u1": 3.0 * np.sin(2.0 * np.pi * 40.0 * time)})
    view = view_of(tmp_path, log, "u1")
    (panel,) = spectrum_figure(view, log_frequency=True, log_magnitude=True).panels
    drawn: Any = panel.marks[0]
    assert drawn.x[np.argmax(drawn.y)] == pytest.approx(40.0, abs=0.2)


def test_linear_systems_are_coherent_and_noise_is_not() -> None:
    rng = np.random.default_rng(2)
    drive = rng.normal(size=40_000)
    channels = {"u1": drive, "theta_m1": T * np.cumsum(drive)}
    channels |= {"u2": rng.normal(size=40_000), "theta_m2": T * np.cumsum(rng.normal(size=40_000))}
    coherent, noise = (mark for mark in coherence_figure(log_with(channels), 2).marks)
    assert np.median(coherent.y) > 0.95  # type: ignore[union-attr]
    assert np.median(noise.y) < 0.5  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("units", "factors", "names"),
    [
        ("deg", (57.29578, 57.29578), ("deg", "deg/s")),
        ("rpm", (57.29578, 9.549297), ("deg", "rpm")),
    ],
)
def test_angles_and_rates_have_the_chosen_units(
    units: str, factors: tuple[float, float], names: tuple[str, str], tmp_path: Path
) -> None:
    channels = motors(500) | {"omega_m1": np.linspace(-3.0, 3.0, 500)}
    log = log_with(channels)
    figure = time_figure(
        view_of(tmp_path, log, "theta_m1", "omega_m1", "u1", units=units), (0.0, 0.5), 1000
    )
    drawn: list[Any] = [panel.marks[0] for panel in figure.panels]
    for line, unit in zip(drawn, (*names, "V"), strict=True):
        assert f"[{unit}]" in line.name
    np.testing.assert_allclose(drawn[0].y, factors[0] * channels["theta_m1"], rtol=1e-6)
    np.testing.assert_allclose(drawn[1].y, factors[1] * channels["omega_m1"], rtol=1e-6)
    np.testing.assert_array_equal(drawn[2].y, channels["u1"])
