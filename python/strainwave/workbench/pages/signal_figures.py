"""Figures of page "Signals": channels of records over time, their spectra, coherence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from strainwave.domain import ArmDescription, FloatArray, IntArray, Log
from strainwave.errors import InvalidInput
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import (
    DASHES,
    FREQUENCY_AXIS,
    PALETTE,
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
_MAX_NAMED = 3  # channels in the title of a panel
_DEGREES = {"rad": (180.0 / math.pi, "deg"), "rad/s": (180.0 / math.pi, "deg/s")}

UNITS: Mapping[str, Mapping[str, tuple[float, str]]] = {
    "rad": {},
    "deg": _DEGREES,
    "rpm": _DEGREES | {"rad/s": (30.0 / math.pi, "rpm")},
}
"""By the choice of the reader, other units in place of SI, and their factors."""

PANELS = ("channel", "unit", "all")
"""What shares a panel: nothing, channels of one unit, or all."""


@dataclass(frozen=True, slots=True)
class ShownRecord:
    """Segments of a record."""

    name: str
    logs: Sequence[Log]
    origin: float = 0.0  # [s] subtracted from its time
    is_before: bool = False  # before the steps of the first record


@dataclass(frozen=True, slots=True)
class View:
    """Channels of records in the units and panels that the reader chose."""

    records: Sequence[ShownRecord]  # the first has every channel
    channels: Sequence[str]
    arm: ArmDescription
    panels: str = "channel"
    units: str = "rad"

    def __post_init__(self) -> None:
        """Raise InvalidInput if the first record lacks a channel, or if there is none."""
        first = self.records[0]
        known = first.logs[0].channels
        unknown = [name for name in self.channels if name not in known]
        if unknown or not self.channels:
            raise InvalidInput(
                f"the record {first.name!r} has no channel {', '.join(unknown) or 'chosen'}",
                remedy=f"choose from: {', '.join(known)}",
            )

    @property
    def has_several(self) -> bool:
        """Whether lines need the names of their records."""
        return len({record.name for record in self.records}) > 1

    def unit(self, channel: str) -> tuple[float, str]:
        """Factor from SI units, and unit of a channel."""
        unit = unit_of(channel, self.arm.joints)
        return UNITS[self.units].get(unit, (1.0, unit))

    def groups(self) -> list[list[str]]:
        """Channels of each panel."""
        groups: dict[str, list[str]] = {}
        for name in self.channels:
            keys = {"channel": name, "unit": self.unit(name)[1], "all": ""}
            groups.setdefault(keys[self.panels], []).append(name)
        return list(groups.values())

    def lines(
        self, group: Sequence[str], points_of: Callable[[Log, str], tuple[FloatArray, FloatArray]]
    ) -> Iterator[Line]:
        """Lines of a panel; `points_of` gives abscissas and values in SI units."""
        n_records = len(self.records)
        for number, record in enumerate(self.records):
            for name in group:
                factor, unit = self.unit(name)
                count = number + n_records * self.channels.index(name)
                style = PALETTE[count % len(PALETTE)], DASHES[count // len(PALETTE) % len(DASHES)]
                label = f"{name} [{unit}]"
                if record.is_before:
                    style, label = (Colour.RESIDUAL, ()), f"{label}, before the steps"
                elif self.has_several:
                    label = f"{label}, {record.name}"
                for log in record.logs:
                    if name in log.channels:
                        x, y = points_of(log, name)
                        yield Line(x - record.origin, factor * y, label, *style)

    def title(self, group: Sequence[str], per: str = "") -> str:
        """Title of a panel."""
        units = dict.fromkeys(self.unit(name)[1] + per for name in group)
        names = f"{', '.join(group)} " if len(group) <= _MAX_NAMED else ""
        return f"{names}[{', '.join(units)}]"


def time_figure(view: View, span: tuple[float, float], points: int) -> Figure:
    """Channels over time, decimated to minimum and maximum per column of about `points`."""
    n_lines = len(view.channels) * sum(len(record.logs) for record in view.records)
    limit = min(points, _MAX_POINTS // n_lines)
    origins = {id(log): record.origin for record in view.records for log in record.logs}

    def points_of(log: Log, name: str) -> tuple[FloatArray, FloatArray]:
        first, last = np.searchsorted(log.time, np.add(span, origins[id(log)]))
        rows = slice(max(int(first) - 1, 0), min(int(last) + 1, len(log)))
        time, values = log.time[rows], log.channels[name][rows]
        drawn = decimate(values, limit)
        return time[drawn], values[drawn]

    panels = [
        Panel(Axis(view.title(group)), _before_first(view.lines(group, points_of)))
        for group in view.groups()
    ]
    title = "time from the start of each record [s]" if view.has_several else "time [s]"
    return Figure(Axis(title, range=span), tuple(panels))


def spectrum_figure(view: View, *, log_frequency: bool, log_magnitude: bool) -> Figure:
    """Amplitude spectral density of channels, by Welch's method."""
    from scipy import signal  # takes half a second

    def points_of(log: Log, name: str) -> tuple[FloatArray, FloatArray]:
        rate = 1.0 / log.sample_time
        frequency, density = signal.welch(log.channels[name], rate, nperseg=_segment(log))
        rows = _shown(frequency) if log_frequency else _evenly(frequency)
        return frequency[rows], np.sqrt(density[rows])

    panels = [
        Panel(
            Axis(view.title(group, "/√Hz"), log=log_magnitude),
            _before_first(view.lines(group, points_of)),
        )
        for group in view.groups()
    ]
    x = FREQUENCY_AXIS if log_frequency else Axis(FREQUENCY_AXIS.title)
    return Figure(x, tuple(panels))


def _before_first(lines: Iterator[Line]) -> tuple[Line, ...]:
    """Grey lines are below the others."""
    return tuple(sorted(lines, key=lambda line: line.colour != Colour.RESIDUAL))


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


def _evenly(frequency: FloatArray) -> IntArray:
    return np.unique(np.linspace(1, len(frequency) - 1, _MAX_LINES).astype(np.intp))
