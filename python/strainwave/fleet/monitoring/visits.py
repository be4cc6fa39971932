"""Arms of a campaign store, their visits, and each parameter over time."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from strainwave.domain.keys import Key, Keyed
from strainwave.errors import InvalidInput, suggest_name
from strainwave.fleet.campaign.store import read_parameters, read_runs
from strainwave.fleet.monitoring.comparison import is_record_parameter
from strainwave.fleet.monitoring.shapes import ParameterSeries
from strainwave.io.atomic_files import decode, read_bytes

_USABLE_STATUS = ("determined", "partly-determined", "not-determined")
_DAY = timedelta(days=1)

Row = Mapping[str, Any]
_ArmNamer = Callable[[Row], tuple[str | None, str | None]]
"""The arm of a run, and its time if the expression has that group."""


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
class ParameterHistory(Keyed):
    """One parameter over the visits of an arm in which it is identified."""

    name: str
    joint: int | None
    unit: str
    stage: str
    visits: tuple[Visit, ...]  # by time
    series: ParameterSeries


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
    notes: tuple[str, ...] = ()


def read_histories(
    store: Path | str, *, arm: str | None = None, covariates: Path | None = None
) -> Histories:
    """Read the arms of a campaign store, with each parameter over time.

    If a study has several runs, the last run is used. Runs that failed or have inconsistent input
    are omitted. Each parameter is read from the stage that estimates it in most visits.

    `arm` is a column of the runs, or a regular expression that is searched for in the study's path:
    its group named `arm`, else its first group, is the arm; a group named `time` is the time of the
    visit. By default an arm is the folder of a study. `covariates` is a CSV table with the columns
    `study`, optionally `time` in ISO 8601, and covariates of the regression. Raises `InvalidInput`
    if the store, the expression or the table is invalid.
    """
    runs = read_runs(store).to_pylist()
    parameters = read_parameters(store).to_pylist()
    conditions = Conditions((), {}, {}) if covariates is None else read_conditions(covariates)
    usable = [row for row in runs if row.get("status") in _USABLE_STATUS]
    notes = []
    if len(usable) < len(runs):
        notes.append(
            f"{len(runs) - len(usable)} of {len(runs)} runs are omitted: they failed or have "
            "inconsistent input"
        )
    latest: dict[str, Row] = {}
    for row in sorted(usable, key=lambda row: str(row["started"])):
        latest[str(row["study"])] = row
    if len(latest) < len(usable):
        notes.append(
            f"{len(usable) - len(latest)} of {len(usable)} runs are omitted: the same study has a "
            "later run"
        )
    arm_namer = _arm_namer(arm, set(runs[0]))
    visits, more_notes = _group_visits(latest.values(), arm_namer, conditions)
    notes += more_notes
    by_run: dict[str, list[Row]] = {}
    for row in parameters:
        by_run.setdefault(str(row["run"]), []).append(row)
    arms = []
    for name, unordered in visits.items():
        arm_visits = sorted(unordered, key=lambda v: (v.time, v.study))
        rows_by_parameter: dict[Key, list[tuple[Visit, Row]]] = {}
        for visit in arm_visits:
            for row in by_run.get(visit.run, ()):
                if _is_usable(row):
                    key = row["name"], row["joint"]
                    rows_by_parameter.setdefault(key, []).append((visit, row))
        series = _parameter_histories(rows_by_parameter, arm_visits[0].time)
        arms.append(ArmHistory(name, tuple(arm_visits), tuple(series)))
    return Histories(tuple(arms), conditions.names, tuple(notes))


def read_conditions(path: Path) -> Conditions:
    """Read a CSV table of covariates; rows with an empty cell are omitted.

    Raises `InvalidInput` if there is no column `study`, or a cell is neither a number nor a time.
    """
    rows = list(csv.DictReader(decode(read_bytes(path, "the table"), path).splitlines()))
    columns = list(rows[0]) if rows else []
    if "study" not in columns:
        raise InvalidInput(
            "has no column 'study'",
            where=str(path),
            remedy="begin with a header such as study,time,temperature",
        )
    names = tuple(name for name in columns if name not in ("study", "time"))
    values, times = {}, {}
    for number, row in enumerate(rows, start=2):
        place = f"{path}, line {number}"
        cells = [row.get(name) or "" for name in names]
        if all(cells):
            values[_study_of(row)] = tuple(_number(cell, place) for cell in cells)
        if row.get("time"):
            times[_study_of(row)] = parse_time(row["time"], place)
    return Conditions(names, values, times)


def parse_time(value: object, where: str) -> datetime:
    """Convert ISO 8601 to UTC; a time without zone is UTC. `InvalidInput` reports `where`."""
    try:
        time = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError as error:
        raise InvalidInput(
            f"{value!r} is not a time",
            where=where,
            remedy="write it as 2026-01-31 or 2026-01-31T12:00",
        ) from error
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InvalidInput(f"{cell!r} is not a finite number", where=where, remedy="write a number")
    return value


def _study_of(row: Mapping[str, Any]) -> str:
    """Path or URL of a study with `/`, also if the campaign ran on Windows."""
    return str(row["study"]).replace("\\", "/")


def _arm_namer(arm: str | None, columns: set[str]) -> _ArmNamer:
    if arm is None:

        def name_folder(row: Row) -> tuple[str, None]:
            """The folder of a study file, or the name of a study without folder."""
            path = PurePosixPath(_study_of(row))
            return path.parent.name or path.stem, None

        return name_folder
    if arm in columns:
        return lambda row: (None if row[arm] is None else str(row[arm]), None)
    try:
        expression = re.compile(arm)
    except re.error as error:
        raise InvalidInput(f"--arm is not a regular expression ({error})") from error
    if not expression.groups:
        raise InvalidInput(
            f"--arm {arm!r} is neither a column of the runs nor a regular expression with a group"
            f"{suggest_name(arm, columns)}",
            remedy="put the name of the arm in parentheses: 'fleet/([^/]+)/'",
        )

    def name_arm(row: Row) -> tuple[str | None, str | None]:
        match = expression.search(_study_of(row))
        if match is None:
            return None, None
        groups = match.groupdict()
        first = next((g for g in match.groups() if g is not None), None)
        return groups.get("arm") or first, groups.get("time")

    return name_arm


def _group_visits(
    rows: Iterable[Row],
    arm_namer: _ArmNamer,
    conditions: Conditions,
) -> tuple[dict[str, list[Visit]], list[str]]:
    """Visits by arm, and notes on omitted visits and on their times."""
    visits: dict[str, list[Visit]] = {}
    names = {*conditions.values, *conditions.times}
    dropped = unnamed = n_started = 0
    for row in rows:
        study = _study_of(row)
        arm, time_text = arm_namer(row)
        # the table names a study, or the end of its path
        parts = PurePosixPath(study).parts
        ends = ("/".join(parts[k:]) for k in range(1, len(parts)))
        key = next((name for name in (study, *ends) if name in names), None)
        if arm is None:
            unnamed += 1
            continue
        if conditions.names and (key is None or key not in conditions.values):
            dropped += 1
            continue
        if key is not None and key in conditions.times:
            time = conditions.times[key]
        elif time_text is not None:
            time = parse_time(time_text, f"study {study}")
        else:
            time = parse_time(row["started"], f"run {row['run']}")
            n_started += 1
        covariates = conditions.values[key] if conditions.names and key is not None else ()
        visits.setdefault(arm, []).append(Visit(str(row["run"]), study, time, covariates))
    if unnamed and not visits:
        raise InvalidInput(
            "--arm matches no study", remedy=f"the store has studies such as {study!r}"
        )
    if dropped and not visits:
        raise InvalidInput(
            "no study of the table of covariates is in the store",
            remedy="write the studies as in the column `study` of the store",
        )
    notes = []
    if dropped:
        notes.append(
            f"{dropped} visits are omitted: they have no complete row in the table of covariates"
        )
    if n_started:
        notes.append(
            "times are those of the runs, not of the recordings; give the recording times in the "
            "column time of --covariates, or as a group named time in --arm"
        )
    return visits, notes


def _is_usable(row: Row) -> bool:
    value, std = row["value"], row["std"]
    finite = value is not None and std is not None and bool(np.isfinite([value, std]).all())
    return finite and std > 0.0 and not is_record_parameter(row["name"])


def _parameter_histories(
    rows_by_parameter: Mapping[Key, Sequence[tuple[Visit, Row]]], start: datetime
) -> Iterator[ParameterHistory]:
    for (name, joint), pairs in rows_by_parameter.items():
        sources = Counter((row["stage"], row["unit"]) for _, row in pairs)
        stage, unit = max(sources, key=sources.__getitem__)
        same_stage = [(v, row) for v, row in pairs if (row["stage"], row["unit"]) == (stage, unit)]
        stage_visits = tuple(visit for visit, _ in same_stage)
        series = ParameterSeries(
            time=np.array([(visit.time - start) / _DAY for visit in stage_visits]),
            value=np.array([float(row["value"]) for _, row in same_stage]),
            std=np.array([float(row["std"]) for _, row in same_stage]),
            covariates=np.array([visit.covariates for visit in stage_visits]).reshape(
                len(stage_visits), -1
            ),
        )
        yield ParameterHistory(name, joint, unit, stage, stage_visits, series)
