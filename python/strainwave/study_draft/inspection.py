"""Log files as a newcomer brings them -> columns of numbers, and what to say of the others."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.clocks import FEWEST_ROWS, Track, one_clock
from strainwave.io.logs.tables import LARGEST, first_impossible, open_table
from strainwave.study_draft.names import MOST_JOINTS, UNITS, parse
from strainwave.study_draft.signal_features import is_clock, time_unit

_FEW_LOST = 0.05  # share of a column's samples; with more lost, what it is can hardly be seen


@dataclass(frozen=True, slots=True)
class Record:
    """One log as far as it could be read."""

    path: Path
    time: FloatArray  # (n_samples,) [s]
    time_column: str | None  # None: a bag's stamps
    time_scale: float  # [s] per unit of the column
    time_unit: str
    columns: dict[str, FloatArray]  # name -> (n_samples,)
    notes: tuple[str, ...]
    faults: tuple[str, ...] = ()  # what `identify` would refuse, or what was left out

    @property
    def period(self) -> float:
        """[s] between samples, usually."""
        return float(np.median(np.diff(self.time)))

    @property
    def is_bag(self) -> bool:
        """Whether its columns are fields of topics."""
        return self.time_column is None

    @property
    def name(self) -> str:
        """The file's, without its endings."""
        return self.path.name.split(".")[0] or self.path.name


def look_at(path: Path) -> Record:
    """Read what can be read of a log.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Record

    Raises
    ------
    InvalidInput
        It is no log, or it has no time, or too few samples.
    """
    if not path.exists():
        raise InvalidInput("the log does not exist", where=str(path), remedy="check the name")
    return _bag(path) if is_bag(path) else _table(path)


def _table(path: Path) -> Record:
    table = open_table(path)
    columns, faults = {}, []
    try:
        columns = table.read(list(table.names))
    except InvalidInput:  # one of them is not numbers; the others may be
        for name in table.names:
            try:
                columns |= table.read([name])
            except InvalidInput as error:
                faults.append(f"column {name!r} is left out: {error.problem}")
    columns, said = _finite(columns)
    rows = max((len(values) for values in columns.values()), default=0)
    columns = {name: values for name, values in columns.items() if len(values) == rows}
    if rows < FEWEST_ROWS:
        raise InvalidInput(
            f"has {rows} row(s) of numbers; at least {FEWEST_ROWS} are needed",
            where=str(path),
            remedy="give a log of an experiment, with a header line",
        )
    name, unit, scale = _clock(columns, path)
    time = scale * columns.pop(name)
    return Record(path, time, name, scale, unit, columns, (), (*faults, *said))


def _clock(columns: dict[str, FloatArray], path: Path) -> tuple[str, str, float]:
    """The column of time, its unit and the unit in seconds."""
    clocks = [name for name, values in columns.items() if is_clock(values)]
    clocks.sort(key=lambda name: parse(name).quantity != "time")
    for name in clocks:
        period = float(np.median(np.diff(columns[name])))
        unit = parse(name).unit
        if unit in UNITS["time"]:
            return name, unit, UNITS["time"][unit]
        guessed = time_unit(period)
        if guessed:
            return name, *guessed
    more = f" ({', '.join(clocks)} increase, but not as a clock of 20 Hz to 50 kHz)"
    raise InvalidInput(
        f"there is no column of time among {', '.join(columns)}{more if clocks else ''}",
        where=str(path),
        remedy="add a column t [s]: the row's number divided by the sampling rate will do"
        + _beyond(columns),
    )


def _beyond(columns: Collection[str]) -> str:
    """A word on logs of more joints than can be identified, before more work goes into them."""
    numbers = {number for name in columns if (number := parse(name).number) is not None}
    if len(numbers) <= MOST_JOINTS:
        return ""
    return (
        f". The columns are of {len(numbers)} joints: an arm of one joint, or of two links in one "
        "plane, is what can be identified so far"
    )


def _bag(path: Path) -> Record:
    bag = Bag(path)
    wanted = [name for name in bag.names if parse(name).quantity not in (None, "time")]
    if not wanted:
        raise InvalidInput(
            "no topic has numbers that look like those of a robot arm",
            where=str(path),
            remedy="record joint states, commands and sensors; write [channels] by hand: "
            "docs/study.md",
        )
    tracks, warnings = bag.tracks(wanted)
    notes, faults = [warning.message for warning in warnings], list[str]()
    usable: list[Track] = []
    for track in tracks:
        columns, said = _finite(track.columns)
        faults += said
        if columns and len(track.time) >= FEWEST_ROWS:
            usable.append(Track(track.name, track.time, columns, track.row_name))
    usable.sort(key=_without_angle)
    commanded = {n for t in usable for n in t.columns if parse(n).quantity in ("voltage", "torque")}
    if not usable:
        raise InvalidInput("the topics are too short", where=str(path), remedy="record for longer")
    as_is = Experiment(path.name, path.name, "motion", ())
    time, columns, found = one_clock(usable, commanded, as_is, path)
    notes += [warning.message for warning in found]
    return Record(path, time, None, 1.0, "s", columns, tuple(notes), tuple(faults))


def _without_angle(track: Track) -> bool:
    return not any(parse(name).quantity == "angle" for name in track.columns)


def _finite(columns: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], list[str]]:
    """Columns of numbers; where few are none, they are interpolated, to see what the column is."""
    kept, said = {}, []
    for name, values in columns.items():
        row = first_impossible(values)
        if row is None:
            kept[name] = values
            continue
        possible = np.abs(values) < LARGEST
        lost = len(values) - int(np.count_nonzero(possible))
        what = (
            f"column {name!r} has {lost} sample(s) that are no number, the first in row {row + 1}"
        )
        if lost > _FEW_LOST * len(values):
            said.append(f"{what}: it is left out")
            continue
        rows = np.arange(len(values))
        kept[name] = np.interp(rows, rows[possible], values[possible])
        said.append(
            f"{what} ({values[row]}): identify refuses the log while a channel uses it. Mend it, "
            "cut it off with start and stop, or rename the column"
        )
    return kept, said


def in_common(records: Sequence[Record]) -> Record:
    """The record with the most columns that change: what columns are is judged by it."""
    return max(records, key=lambda record: sum(np.ptp(v) > 0.0 for v in record.columns.values()))
