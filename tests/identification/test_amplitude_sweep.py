"""Amplitude sweeps: the trend follows from the slope and its standard error."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain import (
    Decoupled,
    Experiment,
    FloatArray,
    JointModel,
    Mode,
    Prbs,
    RecordModel,
    Use,
)
from strainwave.identification import amplitude_sweep as sweep

EMPTY: FloatArray = np.zeros((0, 2))


def record(
    amplitude: float, hz: float, std: float, *, servoed: bool = False, use: Use = "sweep"
) -> RecordModel:
    """Record in which the anti-resonance of joint 1 is at `hz`."""
    experiment = Experiment(
        f"{amplitude:g} V",
        "x.csv",
        use,
        ("open", "servo" if servoed else "open"),
        joint=1,
        prbs=Prbs(10, 1e-3, 4, amplitude),
    )
    signals = Decoupled(
        experiment=experiment,
        joint=1,
        time=EMPTY[:, 0],
        sample_time=1e-3,
        inputs=EMPTY,
        outputs=EMPTY,
        valid=np.zeros(0, dtype=bool),
        held=False,
        total_inertia=1.0,
        total_viscous_friction=None,
        gear_ratio=0.01,
        shared=(),
        bandwidth_hz=None,
        fusion=None,
        richness_hz=EMPTY[:, 0],
        checks=(),
    )
    w = 2.0 * np.pi * hz
    model = JointModel(
        joint=1,
        experiments=(experiment.name,),
        method="grey-box",
        parameters=(),
        values={"link_inertia": 2.0, "gear_stiffness": 2.0 * w**2},
        covariance=np.diag([0.0, (4.0 * w * 2.0 * np.pi * std) ** 2]),
        anti_resonance=Mode(1j * w, hz, 0.03, std, 0.001),
        resonance=None,
        band_hz=(3.0, 60.0),
        fit_percent={},
        status="determined",
    )
    return RecordModel(signals, model, None, None, None)


def test_a_hardening_spring() -> None:
    (result,) = sweep.compare_amplitudes(
        [record(a, 10.0 + 0.3 * a, 0.05) for a in (8.0, 2.0, 4.0, 6.0)]
    )
    assert result.joint == 1
    assert [point.amplitude for point in result.points] == [2.0, 4.0, 6.0, 8.0]
    assert result.verdict == "hardening"
    for point in result.points:
        w = 2.0 * np.pi * (10.0 + 0.3 * point.amplitude)
        assert point.squared_anti_resonance == pytest.approx(w**2)
        assert point.squared_anti_resonance_std == pytest.approx(2.0 * w * 2.0 * np.pi * 0.05)
        assert point.gear_stiffness == pytest.approx(2.0 * w**2)
        assert point.gear_stiffness_std == pytest.approx(2.0 * point.squared_anti_resonance_std)


def test_the_slope_of_a_line_and_its_standard_error() -> None:
    """Squared anti-resonance 4000 + 100 a: slope and standard error of a weighted line."""
    amplitudes = np.array([2.0, 4.0, 6.0, 8.0])
    squared = 4000.0 + 100.0 * amplitudes
    hz = np.sqrt(squared) / (2.0 * np.pi)
    # the standard deviation of the squared anti-resonance is 10 at every amplitude
    std = 10.0 / (2.0 * np.sqrt(squared) * 2.0 * np.pi)
    (result,) = sweep.compare_amplitudes(
        [record(a, f, s) for a, f, s in zip(amplitudes, hz, std, strict=True)]
    )
    assert result.slope == pytest.approx(100.0)
    assert result.slope_std == pytest.approx(10.0 / np.sqrt(np.sum((amplitudes - 5.0) ** 2)))


def test_a_linear_spring_has_no_trend() -> None:
    rng = np.random.default_rng(0)
    points = [record(a, 12.0 + 0.05 * rng.normal(), 0.05) for a in (2.0, 3.0, 4.0, 6.0, 8.0)]
    assert sweep.compare_amplitudes(points)[0].verdict == "no-trend"


def test_a_softening_spring() -> None:
    points = [record(a, 14.0 - 0.3 * a, 0.05) for a in (2.0, 4.0, 6.0)]
    assert sweep.compare_amplitudes(points)[0].verdict == "softening"


def test_two_amplitudes_are_no_sweep_and_servoed_records_are_left_out() -> None:
    two = [record(2.0, 12.0, 0.1), record(4.0, 13.0, 0.1)]
    assert sweep.compare_amplitudes(two) == ()
    servoed = record(10.0, 14.0, 0.1, servoed=True, use="frequency")
    assert sweep.compare_amplitudes([*two, servoed]) == ()
    open_loop = record(10.0, 14.0, 0.1, use="frequency")
    assert len(sweep.compare_amplitudes([*two, open_loop])[0].points) == 3


def test_curvature_of_a_hardening_spring_is_not_scatter() -> None:
    """A saturating stiffness has a trend, although the points are far from a line."""
    records = [
        record(a, hz, 0.01) for a, hz in ((2.0, 10.0), (3.0, 11.6), (4.0, 12.0), (10.0, 12.2))
    ]
    (result,) = sweep.compare_amplitudes(records)
    x = np.array([point.amplitude for point in result.points])
    y = np.array([point.squared_anti_resonance for point in result.points])
    std = np.array([point.squared_anti_resonance_std for point in result.points])
    line = np.polyfit(x, y, 1, w=1.0 / std)
    scatter = np.sum(((y - np.polyval(line, x)) / std) ** 2) / 2.0
    std_about_line = result.slope_std * np.sqrt(scatter)
    assert abs(result.slope) < 3.0 * std_about_line  # the scatter about a line hides the trend
    assert result.verdict == "hardening"


def test_scatter_about_a_parabola_widens_the_standard_error() -> None:
    points = ((2.0, 12.0), (3.0, 12.6), (4.0, 11.8), (6.0, 12.5), (8.0, 12.1))
    (noisy,) = sweep.compare_amplitudes([record(a, hz, 0.01) for a, hz in points])
    (quiet,) = sweep.compare_amplitudes([record(a, 12.0, 0.01) for a, _ in points])
    assert noisy.slope_std > 10.0 * quiet.slope_std
    assert noisy.verdict == "no-trend"
