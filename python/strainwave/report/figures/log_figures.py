"""Figures of logs: chosen channels of records over time, their spectra, and coherence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, product
from typing import Any

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, IntArray, Log
from strainwave.errors import InvalidInput
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import (
    DASHES,
    FREQUENCY_AXIS,
    PALETTE,
    SOLID,
    Axis,
    Colour,
    Figure,
    Line,
    Panel,
    decimate,
    spread_evenly,
)

_SEGMENTS = 8  # of Welch's method
_MAX_SEGMENT = 1 << 16  # [samples] a minute at 1 kHz: 0.015 Hz
_MAX_LINES = 800  # frequencies drawn
_MAX_POINTS = 60_000  # of all lines of a figure
_DEGREES = {"rad": (180.0 / math.pi, "deg"), "rad/s": (180.0 / math.pi, "deg/s")}

UNITS: Mapping[str, Mapping[str, tuple[float, str]]] = {
    "rad": {},
    "deg": _DEGREES,
    "rpm": _DEGREES | {"rad/s": (30.0 / math.pi, "rpm")},
}
"""By the choice of the reader, other units in place of SI, and their factors."""


@dataclass(frozen=True, slots=True)
class ShownRecord:
    """Segments of a record."""

    name: str
    logs: Sequence[Log]
    origin: float | None = None  # [s] of its time, if several records are shown
    is_before: bool = False  # before the steps of the first record


@dataclass(frozen=True, slots=True)
class View:
    """Channels of records, in the panels and units that the reader chose."""

    records: Sequence[ShownRecord]  # the first has every channel
    channels: Sequence[str]
    arm: ArmDescription
    shares_panels: bool = False  # whether channels of one unit have one panel
    units: str = "rad"

    def __post_init__(self) -> None:
        """Raise InvalidInput if the first record lacks a channel, or if there is none."""
        known = self.records[0].logs[0].channels
        unknown = [name for name in self.channels if name not in known]
        if unknown or not self.channels:
            raise InvalidInput(
                f"the record {self.records[0].name!r} has no channel "
                f"{', '.join(unknown) or 'chosen'}",
                remedy=f"choose from: {', '.join(known)}",
            )

    def panels(
        self,
        points_of: Callable[[ShownRecord, Log, str], tuple[FloatArray, FloatArray]],
        *,
        per: str = "",
        log: bool = False,
    ) -> tuple[Panel, ...]:
        """Panels of all channels; `points_of` gives abscissas and values in SI units."""
        groups: dict[str, list[str]] = {}
        for name in self.channels:
            groups.setdefault(self._unit(name)[1] if self.shares_panels else name, []).append(name)
        panels = []
        for names in groups.values():
            lines = list(self._lines(names, points_of))
            lines.sort(key=lambda line: line.colour != Colour.RESIDUAL)  # grey is below
            title = f"{', '.join(names)} [{self._unit(names[0])[1]}{per}]"
            panels.append(Panel(Axis(title, log=log), tuple(lines)))
        return tuple(panels)

    def _unit(self, channel: str) -> tuple[float, str]:
        """Factor from SI units, and unit of a channel."""
        has_servo = self.arm.position_servo is not None
        unit = unit_of(channel, self.arm.joints, commands_angles=has_servo)
        return UNITS[self.units].get(unit, (1.0, unit))

    def _lines(self, names: Sequence[str], points_of: Callable[..., Any]) -> Iterator[Line]:
        for (number, record), name in product(enumerate(self.records), names):
            factor, unit = self._unit(name)
            count = number + len(self.records) * self.channels.index(name)
            style = PALETTE[count % len(PALETTE)], DASHES[count // len(PALETTE) % len(DASHES)]
            label = f"{name} [{unit}]"
            if record.is_before:
                style, label = (Colour.RESIDUAL, SOLID), f"{label}, before the steps"
            elif record.origin is not None:
                label = f"{label}, {record.name}"
            for log in record.logs:
                if name in log.channels:
                    x, y = points_of(record, log, name)
                    yield Line(x, factor * y, label, *style)


def time_figure(view: View, span: tuple[float, float], points: int) -> Figure:
    """Channels over time, decimated to minimum and maximum per column of about `points`."""
    n_lines = len(view.channels) * sum(len(record.logs) for record in view.records)

    def points_of(record: ShownRecord, log: Log, name: str) -> tuple[FloatArray, FloatArray]:
        time = log.time - (record.origin or 0.0)
        first, last = np.searchsorted(time, span)
        rows = np.arange(max(int(first) - 1, 0), min(int(last) + 1, len(log)))
        rows = rows[decimate(log.channels[name][rows], min(points, _MAX_POINTS // n_lines))]
        return time[rows], log.channels[name][rows]

    is_relative = view.records[0].origin is not None
    title = "time from the start of each record [s]" if is_relative else "time [s]"
    return Figure(Axis(title, range=span), view.panels(points_of))


def spectrum_figure(view: View, *, log_frequency: bool, log_magnitude: bool) -> Figure:
    """Amplitude spectral density of channels, by Welch's method."""
    from scipy import signal  # takes half a second

    def points_of(_: ShownRecord, log: Log, name: str) -> tuple[FloatArray, FloatArray]:
        rate = 1.0 / log.sample_time
        frequency, density = signal.welch(log.channels[name], rate, nperseg=_segment(log))
        rows = _shown(frequency)
        if not log_frequency:
            rows = np.unique(np.linspace(1, len(frequency) - 1, _MAX_LINES).astype(np.intp))
        return frequency[rows], np.sqrt(density[rows])

    x = FREQUENCY_AXIS if log_frequency else Axis(FREQUENCY_AXIS.title)
    return Figure(x, view.panels(points_of, per="/√Hz", log=log_magnitude))


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
        if not np.ptp(velocity):
            continue
        pair, rate = (log.channels[drive], velocity), 1.0 / log.sample_time
        frequency, share = signal.coherence(*pair, rate, nperseg=_segment(log))
        rows = _shown(frequency)
        name = f"{drive} and velocity of motor {joint}"
        lines.append(Line(frequency[rows], share[rows], name, colour, dash))
    panel = Panel(Axis("coherence", range=(0.0, 1.02)), tuple(lines))
    return Figure(FREQUENCY_AXIS, (panel,))


def _segment(log: Log) -> int:
    return min(len(log), max(64, 2 * len(log) // (_SEGMENTS + 1)), _MAX_SEGMENT)


def _shown(frequency: FloatArray) -> IntArray:
    return spread_evenly(frequency, frequency[1], float(frequency[-1]), _MAX_LINES)
