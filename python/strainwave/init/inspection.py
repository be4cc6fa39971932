"""Read logs of unknown layout into numeric columns, with notes on unusable columns.

Find the time stamps of a table of unknown layout, and their unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, product
from pathlib import Path
from typing import get_args

import numpy as np

from strainwave.domain import Channel, Experiment, FloatArray
from strainwave.errors import InvalidInput
from strainwave.init.names import UNITS, Quantity, parse
from strainwave.init.signal_features import proportion, relation
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.clock_text import time_of
from strainwave.io.logs.clocks import MIN_SAMPLES, Track, resample_tracks
from strainwave.io.logs.tables import MAX_MAGNITUDE, LogTable, find_invalid_value, open_table
from strainwave.io.logs.updates import segment_table, segment_tracks

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


def find_time(table: LogTable, columns: Mapping[str, FloatArray]) -> TimeColumn:
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


def _text(table: LogTable, columns: Mapping[str, FloatArray]) -> Iterator[Channel]:
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


# maximum share of invalid samples, also of a slow column between its updates; with more, a column
# cannot be classified
_MAX_INVALID_SHARE = 0.95
_MIN_CLOCK_CORRELATION = 0.9999  # of two clocks; the offset between channels of a scope may vary
# quantities of a bag's topics; temperatures have slow topics of their own
_SAMPLED = frozenset(get_args(Quantity)) - {"time", "temperature"}


@dataclass(frozen=True, slots=True)
class InspectedLog:
    """Readable content of one log."""

    path: Path
    time: FloatArray  # (n_samples,) [s]
    source: TimeColumn | None  # of the time stamps; None: those of a bag, with fields of topics
    columns: dict[str, FloatArray]  # name -> (n_samples,)
    notes: tuple[str, ...]
    faults: tuple[str, ...] = ()  # values that `identify` rejects; omitted columns
    units: Mapping[str, str] = field(default_factory=dict)  # column -> unit of a units row

    @property
    def period(self) -> float:
        """Median sampling period [s]."""
        return float(np.median(np.diff(self.time)))

    def relation(self, rate: str, value: str) -> tuple[float, float]:
        """How well one column is the derivative of another: correlation and ratio."""
        return relation(self.columns[rate], self.columns[value], self.time)

    def proportion(self, x: str, y: str) -> tuple[float, float]:
        """Correlation of two columns, and change of `y` per change of `x`."""
        return proportion(*(self.columns[n] - self.columns[n].mean() for n in (x, y)))

    @property
    def name(self) -> str:
        """File name without suffixes."""
        return self.path.name.split(".")[0] or self.path.name


def read_record(path: Path) -> InspectedLog:
    """Read the usable columns of a log.

    Raises InvalidInput if the file is not a log, has no time column or has too few samples.
    """
    if not path.exists():
        raise InvalidInput("the log does not exist", where=str(path), remedy="check the name")
    return _read_bag(path) if is_bag(path) else _read_table(path)


def _read_table(path: Path) -> InspectedLog:
    table = open_table(path)
    columns = {}
    faults = [f"column {name!r} is not used: {what}" for name, what in table.omitted.items()]
    try:
        columns = table.read(list(table.names))
    except InvalidInput:  # a column is not numeric; read each column separately
        for name in table.names:
            try:
                columns |= table.read([name])
            except InvalidInput as error:
                faults.append(f"column {name!r} is not used: {error.problem}")
    columns, value_faults = _valid_columns(columns)
    n_samples = max((len(values) for values in columns.values()), default=0)
    columns = {name: values for name, values in columns.items() if len(values) == n_samples}
    if n_samples < MIN_SAMPLES:
        raise InvalidInput(
            f"has {n_samples} row(s) of numbers; at least {MIN_SAMPLES} are required",
            where=str(path),
            remedy="use the log of an experiment, with a header line",
        )
    source = find_time(table, columns)
    time = np.arange(n_samples, dtype=np.float64)
    if source.channel is not None:
        time = time_of(columns, table.clocks, source.channel)
        columns = {n: v for n, v in columns.items() if n not in source.channel.columns}
    columns = {
        name: values
        for name, values in columns.items()
        if name not in table.clocks and not _repeats_time(name, values, time)
    }
    scale = PLACEHOLDER_PERIOD / source.step if source.scale is None else source.scale
    quantities = {name: parse(name).quantity for name in columns}
    commands = {n for n, q in quantities.items() if q not in ("angle", "velocity", "torque")}
    clock = next((n for n, q in quantities.items() if q in ("angle", "velocity")), "")
    track = Track("", scale * time, columns, table.row_name, commands)
    whole_record = Experiment(path.name, path.name, "motion", ())
    segments, warnings = segment_table(track, clock, whole_record, path)
    longest, *others = max(segments, key=lambda tracks: len(tracks[0].time))
    if others:  # columns of several rates: all rows show their relations
        longest = track
    notes = (*table.notes, *(warning.message for warning in warnings))
    if source.scale is None:
        faults.append(
            "there is no time column, and the sampling rate is unknown: enter it in [channels]."
            " Scales of velocities and frequencies depend on it"
        )
    return InspectedLog(
        path,
        longest.time,
        source,
        dict(longest.columns),
        notes,
        (*faults, *value_faults),
        table.units,
    )


def _repeats_time(name: str, values: FloatArray, time: FloatArray) -> bool:
    """Whether a column is the time of another channel: `torque.time` of a scope."""
    if parse(name.rpartition(".")[2]).quantity != "time" or np.ptp(values) == 0.0:
        return False
    return bool(np.corrcoef(values, time)[0, 1] > _MIN_CLOCK_CORRELATION)


def _read_bag(path: Path) -> InspectedLog:
    bag = Bag(path)
    column_names = [name for name in bag.names if parse(name).quantity in _SAMPLED]
    if not column_names:
        raise InvalidInput(
            "no topic contains signals of a robot arm",
            where=str(path),
            remedy="record joint states, commands and sensors, or write [channels] manually; see "
            "docs/study.md",
        )
    tracks, warnings = bag.tracks(column_names)
    notes, faults = [warning.message for warning in warnings], list[str]()
    usable: list[Track] = []
    for track in tracks:
        columns, value_faults = _valid_columns(track.columns)
        faults += value_faults
        if columns and len(track.time) >= MIN_SAMPLES:
            commands = {n for n in columns if parse(n).quantity in ("voltage", "torque")}
            usable.append(replace(track, columns=columns, commands=commands))
    usable.sort(key=lambda track: all(parse(n).quantity != "angle" for n in track.columns))
    if not usable:
        raise InvalidInput(
            "the topics are too short", where=str(path), remedy="record a longer motion"
        )
    whole_record = Experiment(path.name, path.name, "motion", ())
    clock = next(iter(usable[0].columns))
    segments, split_warnings = segment_tracks(usable, clock, whole_record, path)
    longest = max(segments, key=lambda tracks: len(tracks[0].time))
    time, columns, clock_warnings = resample_tracks(longest, whole_record, path)
    notes += [warning.message for warning in (*split_warnings, *clock_warnings)]
    return InspectedLog(path, time, None, columns, tuple(notes), tuple(faults))


def _valid_columns(columns: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], list[str]]:
    """Return the numeric columns, and messages on invalid samples.

    Invalid samples are interpolated so that the column can be classified; columns with too many are
    omitted.
    """
    valid_columns, messages = {}, []
    for name, values in columns.items():
        row = find_invalid_value(values)
        if row is None:
            valid_columns[name] = values
            continue
        is_valid = np.abs(values) < MAX_MAGNITUDE
        n_invalid = len(values) - int(np.count_nonzero(is_valid))
        fault = (
            f"column {name!r} has {n_invalid} sample(s) that are not a number, "
            f"the first in row {row + 1}"
        )
        if n_invalid > _MAX_INVALID_SHARE * len(values):
            messages.append(f"{fault}: the column is not used")
            continue
        rows = np.arange(len(values))
        valid_columns[name] = np.interp(rows, rows[is_valid], values[is_valid])
        messages.append(
            f"{fault} ({values[row]}): identify interpolates missing values, leaves out stretches"
            " of them, and rejects infinite ones"
        )
    return valid_columns, messages
