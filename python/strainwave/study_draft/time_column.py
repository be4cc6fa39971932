"""Find the time stamps of a table of unknown layout, and their unit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, product

import numpy as np

from strainwave.domain import Channel, FloatArray
from strainwave.io.logs.stamps import time_of
from strainwave.io.logs.tables import Table
from strainwave.study_draft.names import UNITS, parse

PLACEHOLDER_PERIOD = 1e-3
"""[s] Sampling period that is assumed for classification where the logs do not give it."""
_MAX_STEP_RATIO = 10.0  # maximum ratio of a step to the median step of a clock
_MIN_STEADY_SHARE = 0.9  # minimum share of such steps; the others are pauses
_MAX_RESTARTS = 10  # maximum number of steps back of a clock
_EPOCH = (1e9, 3e9)  # [s] since 1970: 2001 to 2065
_UNITS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """Source of the time stamps."""

    channel: Channel | None  # None: there is none, the rows are counted
    unit: str
    scale: float | None  # [s] per unit; None: unknown, as that of a counter of samples
    step: float = field(default=1.0, compare=False)  # median step, in the unit

    @property
    def seconds_per_unit(self) -> float:
        """The scale, or that of the assumed sampling period."""
        return PLACEHOLDER_PERIOD / self.step if self.scale is None else self.scale


def find_time(table: Table, columns: Mapping[str, FloatArray]) -> TimeColumn:
    """Find the time stamps: text, two columns, a column by name, any other clock, a counter."""
    candidates = [*_text(table, columns), *_two_columns(columns)]
    for channel in candidates:
        if _is_clock(time_of(columns, table.clocks, channel), is_strict=False):
            return TimeColumn(channel, "s", 1.0)
    counter = None
    for name in sorted(columns, key=lambda name: parse(name).quantity != "time"):
        is_named = parse(name).quantity == "time"
        time = time_of(columns, table.clocks, Channel(name))
        if name in table.clocks or not _is_clock(time, is_strict=False):
            continue
        unit = table.units.get(name, "").lower()
        known = unit if unit in UNITS["time"] else parse(name).unit
        if known in UNITS["time"]:
            return TimeColumn(Channel(name), str(known), UNITS["time"][str(known)])
        if not is_named and not _is_clock(time, is_strict=True):
            continue
        counts_samples = not is_named and bool(np.all(np.diff(time) == 1.0))
        unit_from_size = None if counts_samples else _unit_by_size(time)
        if unit_from_size:
            return TimeColumn(Channel(name), *unit_from_size)
        if counts_samples or is_named:
            step = float(np.median(np.diff(time)))
            counter = counter or TimeColumn(Channel(name), "units", None, step)
    return counter or TimeColumn(None, "rows", None)


def _text(table: Table, columns: Mapping[str, FloatArray]) -> Iterator[Channel]:
    """Yield columns of text: dates with clock times, alone or in two columns, and clock times."""
    both, dates, clocks = (
        [n for n in columns if table.clocks.get(n) == kind] for kind in ("datetime", "date", "time")
    )
    yield from map(Channel, both)
    yield from (Channel(date, second_column=clock) for date, clock in product(dates, clocks))
    yield from map(Channel, clocks)


def _two_columns(columns: Mapping[str, FloatArray]) -> Iterator[Channel]:
    """Yield whole seconds, with the column of fractions that begins again at each second."""
    for name, seconds in columns.items():
        steps = np.diff(seconds)
        ticks = steps != 0.0
        is_whole = bool(np.all(seconds == np.round(seconds)) and np.all(steps >= 0.0))
        if not ticks.any() or ticks.mean() > 0.5 or not is_whole:
            continue
        for other, fractions in columns.items():
            changes = np.diff(fractions)
            is_rising = np.all(fractions >= 0.0) and np.all(changes[~ticks] >= 0.0)
            if is_rising and np.mean(changes[ticks] < 0.0) > _MIN_STEADY_SHARE:
                yield Channel(name, second_column=other)


def _is_clock(values: FloatArray, *, is_strict: bool) -> bool:
    """Whether values increase in steps of similar size, but for a few pauses unless `is_strict`."""
    steps = np.diff(values[np.isfinite(values)])
    if len(steps) < 2:
        return False
    usual = float(np.median(steps))
    steady = (steps > 0.0) & (steps <= _MAX_STEP_RATIO * usual)
    if is_strict:
        return bool(steady.all())
    has_rate = usual > 0.0 and np.count_nonzero(steps < 0.0) <= _MAX_RESTARTS + len(steps) // 100
    return bool(has_rate and steady.mean() >= _MIN_STEADY_SHARE)


def _unit_by_size(time: FloatArray) -> tuple[str, float] | None:
    """The unit of stamps since 1970, else that in which the period is between 20 us and 50 ms."""
    start, period = float(time[0]), float(np.median(np.diff(time)))
    by_epoch = (u for u in _UNITS if start > 1e6 and _EPOCH[0] <= start * u[1] <= _EPOCH[1])
    by_period = (u for u in _UNITS if 1.9e-5 <= period * u[1] <= 0.051)
    return next(chain(by_epoch, by_period), None)
