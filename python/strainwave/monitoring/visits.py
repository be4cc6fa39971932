"""A campaign's store -> arms, their visits, and each parameter over time."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from strainwave.campaign.store import read_parameters, read_runs
from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput, nearest
from strainwave.io.atomic_files import decode, read_bytes
from strainwave.monitoring.estimates import of_one_record
from strainwave.monitoring.shapes import Series

_ANSWERED = ("determined", "partly-determined", "not-determined")
_DAY = timedelta(days=1)

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a table says of visits beside their logs."""

    names: tuple[str, ...]  # of covariates
    values: Mapping[str, tuple[float, ...]]  # study -> covariates
    times: Mapping[str, datetime]  # study -> when it was recorded


@dataclass(frozen=True, slots=True)
class Visit:
    """One run of an arm."""

    run: str
    study: str
    time: datetime
    covariates: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ParameterHistory:
    """One parameter over the visits of an arm that identified it."""

    name: str
    joint: int | None
    unit: str
    stage: str
    visits: tuple[Visit, ...]  # in the order of time
    series: Series

    @property
    def label(self) -> str:
        """Name with joint, as in the verdict."""
        return self.name if self.joint is None else f"{self.name} {self.joint}"


@dataclass(frozen=True, slots=True, eq=False)
class ArmHistory:
    """All visits to one arm."""

    arm: str
    visits: tuple[Visit, ...]  # in the order of time
    parameters: tuple[ParameterHistory, ...]

    @property
    def start(self) -> datetime:
        """Of its first visit, from which days are counted."""
        return self.visits[0].time


@dataclass(frozen=True, slots=True, eq=False)
class Histories:
    """What a store holds of each arm."""

    arms: tuple[ArmHistory, ...]
    covariates: tuple[str, ...]
    time_from: str  # where the visits' times are from, in words
    notes: tuple[str, ...] = field(default=())


def read_histories(
    store: Path | str, *, arm: str | None = None, covariates: Path | None = None
) -> Histories:
    """Every arm of a store, with each parameter over time.

    Of several runs of one study the last counts. Runs that failed or whose input was inconsistent
    do not. Of a parameter that several stages gave, the stage of most visits counts.

    Parameters
    ----------
    store : Path or str
        Of `strainwave campaign`: folders `runs` and `parameters` of Parquet files.
    arm : str, optional
        A column of the runs, or a regular expression that is searched for in `study`: its group
        named `arm`, else the first; a group named `time` is the visit's time. Without it an arm is
        the folder that a study lies in.
    covariates : Path, optional
        A CSV table with a column `study`, a `time` in ISO 8601, if known, and numbers to regress
        out.

    Returns
    -------
    Histories

    Raises
    ------
    InvalidInput
        The store, the expression or the table is at fault.
    """
    runs = read_runs(store).to_pylist()
    parameters = read_parameters(store).to_pylist()
    known = Conditions((), {}, {}) if covariates is None else read_conditions(covariates)
    answered = [row for row in runs if row.get("status") in _ANSWERED]
    notes = []
    if len(answered) < len(runs):
        notes.append(
            f"{len(runs) - len(answered)} of {len(runs)} runs did not answer and are left out"
        )
    last: dict[str, Row] = {}
    for row in sorted(answered, key=lambda row: str(row["started"])):
        last[str(row["study"])] = row
    if len(last) < len(answered):
        notes.append(
            f"of {len(answered)} runs {len(answered) - len(last)} are earlier ones of the same "
            "study and are left out"
        )
    named = _namer(arm, set(runs[0]))
    visits, time_from, dropped = _visits(last.values(), named, known)
    if dropped:
        notes.append(f"{dropped} visits have no complete row in the table of covariates")
    if time_from == "started":
        notes.append(
            "times are those at which studies were run, not recorded: give the recording's by a "
            "column time of --covariates, or a group named time in --arm"
        )
    by_run: dict[str, list[Row]] = {}
    for row in parameters:
        by_run.setdefault(str(row["run"]), []).append(row)
    arms = tuple(
        _arm_history(name, sorted(own, key=lambda v: (v.time, v.study)), by_run)
        for name, own in visits.items()
    )
    return Histories(arms, known.names, time_from, tuple(notes))


def read_conditions(path: Path) -> Conditions:
    """Read a table of covariates.

    Parameters
    ----------
    path : Path
        CSV with a header.

    Returns
    -------
    Conditions
        Rows with an empty cell are left out.

    Raises
    ------
    InvalidInput
        There is no column `study`, or a cell is neither a number nor a time.
    """
    rows = list(csv.DictReader(decode(read_bytes(path, "the table"), path).splitlines()))
    heads = list(rows[0]) if rows else []
    if "study" not in heads:
        raise InvalidInput(
            "has no column 'study'",
            where=str(path),
            remedy="begin with a line such as study,time,temperature",
        )
    names = tuple(name for name in heads if name not in ("study", "time"))
    values, times = {}, {}
    for number, row in enumerate(rows, start=2):
        place = f"{path}, line {number}"
        cells = [row.get(name) or "" for name in names]
        if all(cells):
            values[row["study"]] = tuple(_number(cell, place) for cell in cells)
        if row.get("time"):
            times[row["study"]] = as_time(row["time"], place)
    return Conditions(names, values, times)


def as_time(value: object, where: str) -> datetime:
    """A time in UTC.

    Parameters
    ----------
    value : datetime or str
        ISO 8601; without a zone it is UTC.
    where : str
        For the message.

    Returns
    -------
    datetime

    Raises
    ------
    InvalidInput
        It is none.
    """
    try:
        found = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError as error:
        raise InvalidInput(
            f"{value!r} is no time",
            where=where,
            remedy="write it as 2026-01-31 or 2026-01-31T12:00",
        ) from error
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


def _number(cell: str, where: str) -> float:
    try:
        found = float(cell)
    except ValueError:
        found = float("nan")
    if not np.isfinite(found):
        raise InvalidInput(f"{cell!r} is no finite number", where=where, remedy="write a number")
    return found


def _namer(arm: str | None, columns: set[str]) -> Callable[[Row], tuple[str | None, str | None]]:
    """What gives a run's arm, and its time where the expression names one."""
    if arm is None:
        return lambda row: (_folder(str(row["study"])), None)
    if arm in columns:
        return lambda row: (None if row[arm] is None else str(row[arm]), None)
    try:
        expression = re.compile(arm)
    except re.error as error:
        raise InvalidInput(f"--arm is no regular expression ({error})") from error
    if not expression.groups:
        raise InvalidInput(
            f"--arm {arm!r} is neither a column of the runs nor an expression with a group"
            f"{nearest(arm, columns)}",
            remedy="put what names an arm in brackets: 'fleet/([^/]+)/'",
        )

    def named(row: Row) -> tuple[str | None, str | None]:
        found = expression.search(str(row["study"]))
        if found is None:
            return None, None
        groups = found.groupdict()
        first = next((g for g in found.groups() if g is not None), None)
        return groups.get("arm") or first, groups.get("time")

    return named


def _folder(study: str) -> str:
    """The folder that a study file lies in; a study without folder is its own arm."""
    path = PurePosixPath(study)
    return path.parent.name or path.stem


def _visits(
    rows: Iterable[Row],
    named: Callable[[Row], tuple[str | None, str | None]],
    known: Conditions,
) -> tuple[dict[str, list[Visit]], str, int]:
    """Visits by arm, where their times are from, and how many have no covariates."""
    found: dict[str, list[Visit]] = {}
    sources: Counter[str] = Counter()
    matched = _Matches(known)
    dropped = unnamed = 0
    for row in rows:
        study = str(row["study"])
        arm, said = named(row)
        key = matched(study)
        if arm is None:
            unnamed += 1
            continue
        if known.names and (key is None or key not in known.values):
            dropped += 1
            continue
        if key is not None and key in known.times:
            time, source = known.times[key], "covariates"
        elif said is not None:
            time, source = as_time(said, f"study {study}"), "--arm"
        else:
            time, source = as_time(row["started"], f"run {row['run']}"), "started"
        sources[source] += 1
        covariates = known.values[key] if known.names and key is not None else ()
        found.setdefault(arm, []).append(Visit(str(row["run"]), study, time, covariates))
    if unnamed and not found:
        raise InvalidInput("--arm fits no study", remedy="try it on a value of the column `study`")
    if dropped and not found:
        raise InvalidInput(
            "no study of the table of covariates is in the store",
            remedy="write the studies as the store's column `study` has them",
        )
    return found, "started" if "started" in sources else "recorded", dropped


class _Matches:
    """Which row of the table a study has: its own name, or a path that ends so."""

    def __init__(self, known: Conditions) -> None:
        self._names = {*known.values, *known.times}

    def __call__(self, study: str) -> str | None:
        if study in self._names:
            return study
        parts = PurePosixPath(study).parts
        for k in range(1, len(parts)):
            end = "/".join(parts[k:])
            if end in self._names:
                return end
        return None


def _arm_history(
    arm: str, visits: Sequence[Visit], by_run: Mapping[str, Sequence[Row]]
) -> ArmHistory:
    start = visits[0].time
    of_parameter: dict[tuple[str, int | None], list[tuple[Visit, Row]]] = {}
    for visit in visits:
        for row in by_run.get(visit.run, ()):
            if _usable(row):
                of_parameter.setdefault((row["name"], row["joint"]), []).append((visit, row))
    return ArmHistory(arm, tuple(visits), tuple(_parameter_histories(of_parameter, start)))


def _usable(row: Row) -> bool:
    value, std = row["value"], row["std"]
    finite = value is not None and std is not None and bool(np.isfinite([value, std]).all())
    return finite and std > 0.0 and not of_one_record(row["name"])


def _parameter_histories(
    of_parameter: Mapping[tuple[str, int | None], Sequence[tuple[Visit, Row]]], start: datetime
) -> Iterator[ParameterHistory]:
    for (name, joint), pairs in of_parameter.items():
        (stage, unit), _ = Counter((row["stage"], row["unit"]) for _, row in pairs).most_common(1)[
            0
        ]
        own = [(v, row) for v, row in pairs if (row["stage"], row["unit"]) == (stage, unit)]
        kept = tuple(visit for visit, _ in own)
        series = Series(
            time=np.array([(visit.time - start) / _DAY for visit in kept]),
            value=_column(own, "value"),
            std=_column(own, "std"),
            covariates=np.array([visit.covariates for visit in kept]).reshape(len(kept), -1),
        )
        yield ParameterHistory(name, joint, unit, stage, kept, series)


def _column(pairs: Sequence[tuple[Visit, Row]], name: str) -> FloatArray:
    return np.array([row[name] for _, row in pairs], dtype=np.float64)
