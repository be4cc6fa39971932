"""Figures of a servo design: loops, steps, shapers and moves."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray
from strainwave.presentation.figures import (
    DASHES,
    DOTTED,
    FREQUENCY_AXIS,
    PALETTE,
    SHORT_DASH,
    SOLID,
    Area,
    Axis,
    Colour,
    Dash,
    Figure,
    Line,
    Mark,
    Panel,
    Upright,
    decimate,
)
from strainwave.servo_design.design import JointServo, LoopResults, ServoDesign
from strainwave.servo_design.report.words import shaper_name
from strainwave.servo_design.verification import Comparison, EstimationError

_MAX_ROWS = 500  # of a band, which has three lines
_LOWEST_SHARE = 0.05  # of the bandwidth: lower frequencies do not matter
_GAIN_RANGE = (-60.0, 80.0)  # [dB]; integrators have no upper limit
_FARTHEST = 2.0  # distance from -1 that is shown
_SHOWN_SETTLINGS = 1.5  # duration of a figure over the settling time
_LABEL_STEP = 0.15  # of a panel, between labels that may overlap
_N_SHAPERS = 3  # lines of a figure
_N_FREQUENCIES = 400
_MODE_MARGIN = 1.6  # ratio of the frequencies shown beyond the modes


def loops_of(joint: JointServo, required: float) -> Figure:
    """Gain, phase and distance from -1 of the open loop, with the band over all plants.

    `required` is the modulus margin.
    """
    gain: list[Mark] = []
    phase: list[Mark] = []
    distance: list[Mark] = []
    servos = list(_servos(joint))
    lowest = min(float(results.margins.bandwidth_hz.min()) for *_, results in servos)
    for name, colour, dash, results in servos:
        band = results.band
        shown = np.flatnonzero(band.hz >= _LOWEST_SHARE * lowest)
        rows = shown[decimate(band.gain_db[shown], _MAX_ROWS)]
        for marks, values in (
            (gain, band.gain_db),
            (phase, band.phase_deg),
            (distance, np.minimum(band.distance, 2.0 * _FARTHEST)),
        ):
            marks.extend(_band(band.hz[rows], values[rows], name, colour, dash))
    ends, level = joint.results.band.hz[shown[[0, -1]]], np.full(2, required)
    distance.append(Line(ends, level, "required distance", Colour.RESIDUAL, DOTTED))
    return Figure(
        FREQUENCY_AXIS,
        (
            Panel(Axis("gain [dB]", range=_GAIN_RANGE), tuple(gain)),
            Panel(Axis("phase [degree]"), tuple(phase)),
            Panel(Axis("|1 + L|", range=(0.0, _FARTHEST)), tuple(distance)),
        ),
    )


def steps_of(joint: JointServo) -> Figure:
    """Steps of the link, with the band over all plants."""
    servos = list(_servos(joint))
    shown = max(_duration(results.steps.settling, results.steps.time) for *_, results in servos)
    marks: list[Mark] = []
    for name, colour, dash, results in servos:
        steps = results.steps
        marks += _over_time(steps.time, steps.link, shown, name, colour, dash)
    return Figure(Axis("time [s]"), (Panel(Axis("link angle / step"), tuple(marks)),))


def moves_of(move: Comparison) -> Figure:
    """A step and the planned move, with the band over the simulated draws."""
    settling = np.array([move.step.settling, move.planned.settling])
    shown = _duration(settling, move.time)
    marks = [
        *_over_time(move.time, move.step_link, shown, "step", Colour.MEASURED, SHORT_DASH),
        *_over_time(move.time, move.planned_link, shown, "planned", Colour.MODEL, SOLID),
    ]
    return Figure(Axis("time [s]"), (Panel(Axis("link angle / move"), tuple(marks)),))


def estimation_of(one: EstimationError) -> Figure:
    """Errors of the link angle in a planned move, by the motor alone and by the observer."""
    rows = np.linspace(0, len(one.time) - 1, min(len(one.time), _MAX_ROWS)).astype(int)
    servos = (("motor", Colour.MEASURED, SHORT_DASH), ("observer", Colour.MODEL, SOLID))
    marks = tuple(
        Line(one.time[rows], 1e6 * one.errors[rows, k], name, colour, dash)
        for k, (name, colour, dash) in enumerate(servos)
    )
    return Figure(Axis("time [s]"), (Panel(Axis("error [1e-6 rad or m]"), marks),))


def shapers_of(design: ServoDesign) -> Figure:
    """Residual vibration of the best shapers over the frequency of a mode."""
    low, high = design.modes_hz.min(), design.modes_hz.max()
    hz = np.geomspace(low / _MODE_MARGIN, high * _MODE_MARGIN, _N_FREQUENCIES)
    damping = np.full(len(hz), design.shapers[0].shapers[0].damping)
    lines = [
        Line(
            hz,
            100.0 * ranked.impulses.residual_vibration(2.0 * np.pi * hz, damping),
            f"{k + 1}: {shaper_name(ranked)}",
            PALETTE[k],
            DASHES[k],
        )
        for k, ranked in enumerate(design.shapers[:_N_SHAPERS])
    ]
    intervals = [
        Area(np.array(ends), np.zeros(2), np.full(2, 100.0), Colour.RESIDUAL, f"mode {k}")
        for k, ends in enumerate(design.modes_hz.tolist(), start=1)
    ]
    labels = tuple(
        Upright(float(low), f"mode {k + 1}", height=1.0 - _LABEL_STEP * k)
        for k, (low, _) in enumerate(design.modes_hz)
    )
    axis = Axis("vibration [%]", range=(0.0, 100.0))
    return Figure(FREQUENCY_AXIS, (Panel(axis, (*intervals, *lines)),), labels)


def _servos(joint: JointServo) -> Iterator[tuple[str, Colour, Dash, LoopResults]]:
    """Current and designed servo with their style."""
    if joint.current_results is not None:
        yield "current", Colour.MEASURED, SHORT_DASH, joint.current_results
    yield "designed", Colour.MODEL, SOLID, joint.results


def _band(
    x: FloatArray, values: FloatArray, name: str, colour: Colour, dash: Dash
) -> tuple[Mark, ...]:
    """The range and the middle line of values (n, 3): smallest, of the estimates, largest."""
    low, middle, high = values.T
    return Area(x, low, high, colour, name), Line(x, middle, name, colour, dash)


def _over_time(
    time: FloatArray, link: FloatArray, shown: float, name: str, colour: Colour, dash: Dash
) -> tuple[Mark, ...]:
    """Band and line of motions (n_samples, 3) until a time [s]."""
    values = link[: int(np.searchsorted(time, shown))]
    rows = decimate(values, _MAX_ROWS)
    return _band(time[rows], values[rows], name, colour, dash)


def _duration(settling: FloatArray, time: FloatArray) -> float:
    """Time [s] to show, until all plants have settled."""
    longest = float(settling.max())
    end = float(time[-1])
    return min(end, _SHOWN_SETTLINGS * longest) if math.isfinite(longest) else end
