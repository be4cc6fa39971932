"""Views of a record: signals over time, spectra, coherence, and what is marked in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from strainwave.domain import (
    ArmDescription,
    BoolArray,
    FloatArray,
    IntArray,
    Log,
    channel_parts,
)
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.presentation.figures import (
    DASHES,
    FREQUENCY_AXIS,
    PALETTE,
    Axis,
    Figure,
    Line,
    Panel,
    decimate,
    spread_evenly,
)
from strainwave.presentation.report.predictions import unit_of
from strainwave.signals import hygiene
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.standstill import runs_of
from strainwave.study_draft.signal_features import sequence_of, sequence_under_servo

_SEGMENTS = 8  # of Welch's method

_MAX_LINES = 800  # frequencies drawn

_MAX_MARKS = 200  # listed; the largest

_MIN_STANDSTILL = 0.05  # [s] shorter ones belong to every reversal


@dataclass(frozen=True, slots=True)
class Mark:
    """A stretch of a channel."""

    kind: str
    channel: str
    start: float  # [s]
    stop: float  # [s]


def require_channels(log: Log, names: Sequence[str]) -> list[str]:
    """The names; raises InvalidInput if one is no channel of the log, or if there is none."""
    unknown = [name for name in names if name not in log.channels]
    if unknown or not names:
        raise InvalidInput(
            f"the record {log.name!r} has no channel {', '.join(unknown) or 'chosen'}",
            remedy=f"choose from: {', '.join(log.channels)}",
        )
    return list(names)


def time_figure(
    log: Log, arm: ArmDescription, names: Sequence[str], span: tuple[float, float], points: int
) -> Figure:
    """Channels over time in one panel each, decimated to minimum and maximum per column."""
    first, last = np.searchsorted(log.time, span)
    first, last = max(int(first) - 1, 0), min(int(last) + 1, len(log))
    panels = []
    for name, colour in zip(require_channels(log, names), cycle(PALETTE), strict=False):
        values, time = log.channels[name][first:last], log.time[first:last]
        rows = decimate(values, points)
        title = f"{name} [{unit_of(name, arm.joints)}]"
        panels.append(Panel(Axis(title), (Line(time[rows], values[rows], name, colour),)))
    return Figure(Axis("time [s]", range=span), tuple(panels))


def spectrum_figure(log: Log, arm: ArmDescription, names: Sequence[str]) -> Figure:
    """Amplitude spectral density of channels, by Welch's method."""
    from scipy import signal  # takes half a second

    panels = []
    for name, colour in zip(require_channels(log, names), cycle(PALETTE), strict=False):
        frequency, density = signal.welch(
            log.channels[name], 1.0 / log.sample_time, nperseg=_segment(log)
        )
        rows = _shown(frequency)
        title = f"{name} [{unit_of(name, arm.joints)}/√Hz]"
        line = Line(frequency[rows], np.sqrt(density[rows]), name, colour)
        panels.append(Panel(Axis(title, log=True), (line,)))
    return Figure(FREQUENCY_AXIS, tuple(panels))


def coherence_figure(log: Log, n_joints: int) -> Figure:
    """Coherence of each motor's input and velocity."""
    from scipy import signal

    lines = []
    styles = zip(range(1, n_joints + 1), cycle(PALETTE), cycle(DASHES), strict=False)
    for joint, colour, dash in styles:
        drive = next((c for c in (f"u{joint}", f"torque{joint}") if c in log.channels), None)
        if drive is None or not np.ptp(log.channels[drive]):
            continue
        velocity = np.gradient(log.channels[f"theta_m{joint}"], log.sample_time)
        frequency, share = signal.coherence(
            log.channels[drive], velocity, 1.0 / log.sample_time, nperseg=_segment(log)
        )
        rows = _shown(frequency)
        name = f"{drive} and velocity of motor {joint}"
        lines.append(Line(frequency[rows], share[rows], name, colour, dash))
    panel = Panel(Axis("coherence", range=(0.0, 1.02)), tuple(lines))
    return Figure(FREQUENCY_AXIS, (panel,))


def _segment(log: Log) -> int:
    return min(len(log), max(64, 2 * len(log) // (_SEGMENTS + 1)))


def _shown(frequency: FloatArray) -> IntArray:
    return spread_evenly(frequency, frequency[1], float(frequency[-1]), _MAX_LINES)


def marks_of(log: Log, arm: Arm) -> list[Mark]:
    """Saturation, standstill and defects of sensors, in the order of time."""
    marks = [*_saturated(log, arm), *_standing(log, arm), *_defects(log, arm)]
    longest = sorted(marks, key=lambda m: m.start - m.stop)[:_MAX_MARKS]
    return sorted(longest, key=lambda m: (m.start, m.channel))


def _saturated(log: Log, arm: Arm) -> Iterator[Mark]:
    record = prepare_record(log, arm)
    for channel, at in zip(record.channels, record.saturation.samples.T, strict=True):
        yield from _stretches(log, "saturation", channel, at)


def _standing(log: Log, arm: Arm) -> Iterator[Mark]:
    for joint, at in enumerate(prepare_record(log, arm).sliding.T == 0.0, start=1):
        for mark in _stretches(log, "standstill", f"theta_m{joint}", at):
            if mark.stop - mark.start >= _MIN_STANDSTILL:
                yield mark


def _defects(log: Log, arm: Arm) -> Iterator[Mark]:
    for defect in hygiene.detect_defects([log], arm)[0]:
        last = min(defect.stop, len(log) - 1)
        kind = defect.kind.replace("-", " ")
        yield Mark(kind, defect.channel, float(log.time[defect.start]), float(log.time[last]))


def _stretches(log: Log, kind: str, channel: str, at: BoolArray) -> Iterator[Mark]:
    for start, stop in runs_of(at).tolist():
        last = min(stop, len(log) - 1)
        yield Mark(kind, channel, float(log.time[start]), float(log.time[last]))


def sequences_of(log: Log) -> list[str]:
    """A sentence about each pseudo-random binary sequence in the inputs."""
    sentences = []
    for name, values in log.channels.items():
        if channel_parts(name)[0] not in ("u", "torque"):
            continue
        prbs = sequence_of(values, log.sample_time)
        prbs = prbs or sequence_under_servo(values, log.sample_time)
        if prbs is not None:
            unit = unit_of(name)
            sentences.append(
                f"{name}: PRBS of order {prbs.order}, clock {1e3 * prbs.clock:g} ms,"
                f" {prbs.periods:g} periods, amplitude {prbs.amplitude:g} {unit}"
            )
    return sentences
