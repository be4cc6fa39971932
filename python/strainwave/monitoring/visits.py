"""Arms of a campaign store, their visits, and each parameter over time."""

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
from strainwave.monitoring.estimates import is_of_one_record
from strainwave.monitoring.shapes import Series

_USABLE_STATUS = ("determined", "partly-determined", "not-determined")
_DAY = timedelta(days=1)

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Conditions:
    """Covariates and times of visits, from a table."""

    names: tuple[str, ...]  # of the covariates
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
    """One parameter over the visits of an arm in which it is identified."""

    name: str
    joint: int | None
    unit: str
    stage: str
    visits: tuple[Visit, ...]  # by time
    series: Series

    @property
    def label(self) -> str:
        """Name with joint, as in the verdict."""
        return self.name if self.joint is None else f"{self.name} {self.joint}"


@dataclass(frozen=True, slots=True, eq=False)
class ArmHistory:
    """All visits to one arm."""

    arm: str
    visits: tuple[Visit, ...]  # by time
    parameters: tuple[ParameterHistory, ...]

    @property
    def start(self) -> datetime:
        """Time of the first visit, day zero of the series."""
        return self.visits[0].time


@dataclass(frozen=True, slots=True, eq=False)
class Histories:
    """All arms of a store."""

    arms: tuple[ArmHistory, ...]
    covariates: tuple[str, ...]
    time_from: str  # source of the times: "started" or "recorded"
    notes: tuple[str, ...] = field(default=())


def read_histories(
    store: Path | str, *, arm: str | None = None, covariates: Path | None = None
) -> Histories:
    """Arms of the store of a campaign, with each parameter over time.

    Of several runs of one study the last counts. Runs that failed or have inconsistent input are
    left out. Each parameter is followed in the stage that most visits have it from.

    `arm` is a column of the runs, or a regular expression that is searched for in the study's path:
    its group named `arm`, else its first group, is the arm; a group named `time` is the time of the
    visit. By default an arm is the folder of a study. `covariates` is a CSV table with the columns
    `study`, optionally `time` in ISO 8601, and numbers to regress out. Raises `InvalidInput` if the
    store, the expression or the table is at fault.
    """
    runs = read_runs(store).to_pylist()
    parameters = read_parameters(store).to_pylist()
    conditions = Conditions((), {}, {}) if covariates is None else read_conditions(covariates)
    usable = [row for row in runs if row.get("status") in _USABLE_STATUS]
    notes = []
    if len(usable) < len(runs):
        notes.append(
            f"{len(runs) - len(usable)} of {len(runs)} runs are left out: they failed or have "
            "inconsistent input"
        )
    last: dict[str, Row] = {}
    for row in sorted(usable, key=lambda row: str(row["started"])):
        last[str(row["study"])] = row
    if len(last) < len(usable):
        notes.append(
            f"{len(usable) - len(last)} of {len(usable)} runs are left out: the same study has a "
            "later run"
        )
    named = _namer(arm, set(runs[0]))
    visits, time_from, dropped = _visits(last.values(), named, conditions)
    if dropped:
        notes.append(
            f"{dropped} visits are left out: they have no complete row in the table of covariates"
        )
    if time_from == "started":
        notes.append(
            "times are those of the runs, not of the recordings; give the latter in a column time "
            "of --covariates, or as a group named time in --arm"
        )
    by_run: dict[str, list[Row]] = {}
    for row in parameters:
        by_run.setdefault(str(row["run"]), []).append(row)
    arms = tuple(
        _arm_history(name, sorted(own, key=lambda v: (v.time, v.study)), by_run)
        for name, own in visits.items()
    )
    return Histories(arms, conditions.names, time_from, tuple(notes))


def read_conditions(path: Path) -> Conditions:
    """Read a CSV table of covariates; rows with an empty cell are left out.

    Raises `InvalidInput` if there is no column `study`, or a cell is neither a number nor a time.
    """
    rows = list(csv.DictReader(decode(read_bytes(path, "the table"), path).splitlines()))
    heads = list(rows[0]) if rows else []
    if "study" not in heads:
        raise InvalidInput(
            "has no column 'study'",
            where=str(path),
            remedy="begin with a header such as study,time,temperature",
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
    """A time in UTC from ISO 8601, which is UTC without a zone; `InvalidInput` names `where`."""
    try:
        found = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError as error:
        raise InvalidInput(
            f"{value!r} is not a time",
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
        raise InvalidInput(f"{cell!r} is not a finite number", where=where, remedy="write a number")
    return found


def _namer(arm: str | None, columns: set[str]) -> Callable[[Row], tuple[str | None, str | None]]:
    """A function that gives the arm of a run, and its time if the expression has a group for it."""
    if arm is None:
        return lambda row: (_folder(str(row["study"])), None)
    if arm in columns:
        return lambda row: (None if row[arm] is None else str(row[arm]), None)
    try:
        expression = re.compile(arm)
    except re.error as error:
        raise InvalidInput(f"--arm is not a regular expression ({error})") from error
    if not expression.groups:
        raise InvalidInput(
            f"--arm {arm!r} is neither a column of the runs nor a regular expression with a group"
            f"{nearest(arm, columns)}",
            remedy="put the name of the arm in brackets: 'fleet/([^/]+)/'",
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
    """The folder of a study file, or the name of a study without folder."""
    path = PurePosixPath(study)
    return path.parent.name or path.stem


def _visits(
    rows: Iterable[Row],
    named: Callable[[Row], tuple[str | None, str | None]],
    conditions: Conditions,
) -> tuple[dict[str, list[Visit]], str, int]:
    """Visits by arm, the source of their times, and the number of visits without covariates."""
    found: dict[str, list[Visit]] = {}
    sources: Counter[str] = Counter()
    matched = _Matcher(conditions)
    dropped = unnamed = 0
    for row in rows:
        study = str(row["study"])
        arm, time_text = named(row)
        key = matched(study)
        if arm is None:
            unnamed += 1
            continue
        if conditions.names and (key is None or key not in conditions.values):
            dropped += 1
            continue
        if key is not None and key in conditions.times:
            time, source = conditions.times[key], "covariates"
        elif time_text is not None:
            time, source = as_time(time_text, f"study {study}"), "--arm"
        else:
            time, source = as_time(row["started"], f"run {row['run']}"), "started"
        sources[source] += 1
        covariates = conditions.values[key] if conditions.names and key is not None else ()
        found.setdefault(arm, []).append(Visit(str(row["run"]), study, time, covariates))
    if unnamed and not found:
        raise InvalidInput(
            "--arm matches no study", remedy=f"the store has studies such as {study!r}"
        )
    if dropped and not found:
        raise InvalidInput(
            "no study of the table of covariates is in the store",
            remedy="write the studies as in the column `study` of the store",
        )
    return found, "started" if "started" in sources else "recorded", dropped


class _Matcher:
    """The row of the table for a study: its name, or the end of its path."""

    def __init__(self, conditions: Conditions) -> None:
        self._names = {*conditions.values, *conditions.times}

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
    return finite and std > 0.0 and not is_of_one_record(row["name"])


def _parameter_histories(
    of_parameter: Mapping[tuple[str, int | None], Sequence[tuple[Visit, Row]]], start: datetime
) -> Iterator[ParameterHistory]:
    for (name, joint), pairs in of_parameter.items():
        (stage, unit), _ = Counter((row["stage"], row["unit"]) for _, row in pairs).most_common(1)[
            0
        ]
        own = [(v, row) for v, row in pairs if (row["stage"], row["unit"]) == (stage, unit)]
        of_stage = tuple(visit for visit, _ in own)
        series = Series(
            time=np.array([(visit.time - start) / _DAY for visit in of_stage]),
            value=_column(own, "value"),
            std=_column(own, "std"),
            covariates=np.array([visit.covariates for visit in of_stage]).reshape(
                len(of_stage), -1
            ),
        )
        yield ParameterHistory(name, joint, unit, stage, of_stage, series)


def _column(pairs: Sequence[tuple[Visit, Row]], name: str) -> FloatArray:
    return np.array([row[name] for _, row in pairs], dtype=np.float64)
