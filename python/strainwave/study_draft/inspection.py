"""Read logs of unknown layout into numeric columns, with notes on unusable columns."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from strainwave.domain import Experiment, FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.clocks import MIN_SAMPLES, Track, resample_tracks
from strainwave.io.logs.tables import MAX_MAGNITUDE, find_invalid_value, open_table
from strainwave.study_draft.names import UNITS, Quantity, max_joints, parse
from strainwave.study_draft.signal_features import is_clock, time_unit

_MAX_INVALID_SHARE = (
    0.05  # maximum share of invalid samples; with more, a column cannot be classified
)
# quantities of a bag's topics; temperatures have slow topics of their own
_SAMPLED = frozenset(get_args(Quantity)) - {"time", "temperature"}


@dataclass(frozen=True, slots=True)
class Record:
    """Readable content of one log."""

    path: Path
    time: FloatArray  # (n_samples,) [s]
    time_column: str | None  # None: time stamps of a bag
    time_scale: float  # [s] per unit of the column
    time_unit: str
    columns: dict[str, FloatArray]  # name -> (n_samples,)
    notes: tuple[str, ...]
    faults: tuple[str, ...] = ()  # values that `identify` rejects; omitted columns
    units: Mapping[str, str] = field(default_factory=dict)  # column -> unit of a units row

    @property
    def period(self) -> float:
        """Median sampling period [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def is_bag(self) -> bool:
        """Whether the record is a bag, whose columns are fields of topics."""
        return self.time_column is None

    @property
    def name(self) -> str:
        """File name without suffixes."""
        return self.path.name.split(".")[0] or self.path.name


def read_record(path: Path) -> Record:
    """Read the usable columns of a log.

    Raises InvalidInput if the file is not a log, has no time column or has too few samples.
    """
    if not path.exists():
        raise InvalidInput("the log does not exist", where=str(path), remedy="check the name")
    return _read_bag(path) if is_bag(path) else _read_table(path)


def _read_table(path: Path) -> Record:
    table = open_table(path)
    columns, faults = {}, []
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
    name, unit, scale = _time_column(columns, table.units, path)
    time = scale * columns.pop(name)
    return Record(path, time, name, scale, unit, columns, (), (*faults, *value_faults), table.units)


class _TimeColumn(NamedTuple):
    name: str
    unit: str
    scale: float  # the unit in seconds


def _time_column(
    columns: dict[str, FloatArray], units: Mapping[str, str], path: Path
) -> _TimeColumn:
    clocks = [name for name, values in columns.items() if is_clock(values)]
    clocks.sort(key=lambda name: parse(name).quantity != "time")
    for name in clocks:
        period = float(np.median(np.diff(columns[name])))
        unit = parse(name, (), units.get(name, "")).unit
        if unit in UNITS["time"]:
            return _TimeColumn(name, unit, UNITS["time"][unit])
        unit_from_period = time_unit(period)
        if unit_from_period:
            return _TimeColumn(name, *unit_from_period)
    increasing = f" ({', '.join(clocks)} increase, but not at a rate of 20 Hz to 50 kHz)"
    raise InvalidInput(
        f"there is no time column among {', '.join(columns)}{increasing if clocks else ''}",
        where=str(path),
        remedy="add a column t [s], for example the row number divided by the sampling rate"
        + _joint_limit_remark(columns),
    )


def _joint_limit_remark(columns: Collection[str]) -> str:
    """Return a remark if the columns have more joints than a supported arm, else an empty text."""
    numbers = {number for name in columns if (number := parse(name).number) is not None}
    if len(numbers) <= max_joints():
        return ""
    return (
        f". The columns are of {len(numbers)} joints, but an arm has at most {max_joints()}; leave"
        " out those of joints at standstill"
    )


def _read_bag(path: Path) -> Record:
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
            usable.append(Track(track.name, track.time, columns, track.row_name))
    usable.sort(key=lambda track: all(parse(n).quantity != "angle" for n in track.columns))
    commanded = {n for t in usable for n in t.columns if parse(n).quantity in ("voltage", "torque")}
    if not usable:
        raise InvalidInput(
            "the topics are too short", where=str(path), remedy="record a longer motion"
        )
    whole_record = Experiment(path.name, path.name, "motion", ())
    time, columns, clock_warnings = resample_tracks(usable, commanded, whole_record, path)
    notes += [warning.message for warning in clock_warnings]
    return Record(path, time, None, 1.0, "s", columns, tuple(notes), tuple(faults))


def _valid_columns(columns: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], list[str]]:
    """Return the numeric columns, and messages on invalid samples.

    A few invalid samples are interpolated so that the column can be classified; columns with more
    are omitted.
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
            f"{fault} ({values[row]}): identify rejects the log if a channel uses it. Correct the "
            "values, exclude them with start and stop, or rename the column"
        )
    return valid_columns, messages


def find_fullest_record(records: Sequence[Record]) -> Record:
    """Return the record with the most varying columns, which is used to classify columns."""
    return max(records, key=lambda record: sum(np.ptp(v) > 0.0 for v in record.columns.values()))
