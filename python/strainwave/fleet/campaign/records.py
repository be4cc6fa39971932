"""Tasks, their outcomes, and runs as rows of the tables of a store.

Tasks and outcomes are sent as one line of JSON each. The types of rows do not depend on values.
"""

from __future__ import annotations

import hashlib
import json
import os
import pkgutil
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import starmap
from typing import Any

import pyarrow as pa

from strainwave.domain import Identification, Parameter, Stage
from strainwave.domain.keys import Key, label_of
from strainwave.fleet.campaign.study_files import Case, Opened
from strainwave.io.results import to_document, to_json
from strainwave.version import __version__

FAILED_STATUS = "failed"
"""Status of a run without a verdict: wrong input, a crash, or the time limit."""


@dataclass(frozen=True)
class RunLimits:
    """Limits of a run."""

    time_s: float = 600.0
    memory_mib: int | None = None  # address space; None: no limit
    tasks: int = 100  # of one worker process before it is replaced


@dataclass(frozen=True, kw_only=True)
class Task:
    """A case with stages, options and store."""

    case: Case
    study_sha256: str | None
    inputs_sha256: str
    stages: tuple[Stage, ...]
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    store: str  # absolute path, or URL
    campaign: str
    version: str = __version__

    @property
    def options_sha256(self) -> str:
        """Hash of stages and options."""
        return _digest([self.stages, self.options])

    @property
    def run(self) -> str:
        """Name of the run: a hash of case, study, logs, options and version."""
        identity = [self.case.name, self.study_sha256, self.inputs_sha256]
        return _digest([*identity, self.options_sha256, self.version])[:32]

    def row(self) -> dict[str, Any]:
        """Columns of the row of a run that are known before it starts."""
        return {
            "run": self.run,
            "study": self.case.name,
            "study_sha256": self.study_sha256,
            "inputs_sha256": self.inputs_sha256,
            "options_sha256": self.options_sha256,
            "version": self.version,
            "campaign": self.campaign,
            "stages": ",".join(self.stages),
        }

    def to_json(self) -> str:
        """One line."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        kind = type(self.case)
        case = {"kind": f"{kind.__module__}:{kind.__qualname__}", "fields": vars(self.case)}
        return json.dumps(fields | {"case": case})

    @classmethod
    def from_json(cls, text: str) -> Task:
        """The task of a line."""
        fields = json.loads(text)
        kind = pkgutil.resolve_name(fields["case"]["kind"])
        fields |= {"case": kind(**fields["case"]["fields"]), "stages": tuple(fields["stages"])}
        return cls(**fields)


OUTCOME_COLUMNS = ("run", "study", "status", "exit_code", "message", "seconds", "started")
"""Columns of a run that the driver needs."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a run for the driver, with `OUTCOME_COLUMNS`; the store has the whole record."""

    run: str
    study: str
    status: str
    exit_code: int
    message: str
    seconds: float
    started: datetime  # UTC
    skipped: bool = False  # recorded before
    unrecorded: str = ""  # reason why it is not in the store

    @classmethod
    def of(cls, row: Mapping[str, Any], *, unrecorded: str = "") -> Outcome:
        """The outcome of a row of the runs."""
        return cls(**{name: row[name] for name in OUTCOME_COLUMNS}, unrecorded=unrecorded)

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self) | {"started": self.started.isoformat()})

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        """The outcome of a line."""
        fields = json.loads(text)
        return cls(**fields | {"started": datetime.fromisoformat(fields["started"])})


def merged(tables: Sequence[Mapping[str, Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Tables of options, stage -> key -> value, merged so that later ones override."""
    options: dict[str, dict[str, Any]] = {}
    for table in tables:
        for stage, values in table.items():
            options.setdefault(stage, {}).update(values)
    return options


def _digest(values: object) -> str:
    """SHA-256 of plain JSON values."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


TIMED_PARTS = ("read", "consistency", "rigid", "decoupled", "tuned", "checks")
"""Parts of a run whose time has a column, `read_s` and so on."""

RUNS_SCHEMA = pa.schema(
    [
        ("run", pa.string()),  # hash of case, inputs, options and version
        ("study", pa.string()),  # path or URL
        ("study_sha256", pa.string()),
        ("inputs_sha256", pa.string()),  # of the logs that the study names
        ("options_sha256", pa.string()),  # of stages and options
        ("version", pa.string()),
        ("campaign", pa.string()),
        ("stages", pa.string()),  # rigid,decoupled,tuned
        ("status", pa.string()),
        ("exit_code", pa.int32()),
        ("message", pa.string()),  # why it is not determined
        ("started", pa.timestamp("us")),  # UTC
        ("seconds", pa.float64()),
        ("worker", pa.string()),  # host:process
        ("result", pa.string()),  # path of result.json in the store
        ("identified", pa.list_(pa.string())),
        ("not_identified", pa.list_(pa.string())),
        ("rejected", pa.list_(pa.string())),
        ("validated_rigid", pa.bool_()),
        ("validated_elastic", pa.bool_()),
        ("suspected", pa.list_(pa.string())),  # codes
        ("warnings", pa.list_(pa.string())),  # codes
        *((f"{part}_s", pa.float64()) for part in TIMED_PARTS),
        ("classes", pa.string()),  # JSON: properties of a virtual arm
    ]
)
"""One row per run."""

PARAMETERS_SCHEMA = pa.schema(
    [
        ("run", pa.string()),
        ("study", pa.string()),
        ("name", pa.string()),
        ("joint", pa.int32()),  # null: of the arm
        ("value", pa.float64()),  # null: not identified
        ("std", pa.float64()),
        ("ci95_low", pa.float64()),
        ("ci95_high", pa.float64()),
        ("unit", pa.string()),
        ("stage", pa.string()),
        ("true_value", pa.float64()),  # of virtual arms
        ("error_percent", pa.float64()),  # 100 (value - true_value) / |true_value|
    ]
)
"""One row per parameter of a run."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class RunRecord:
    """Row, parameters and result of a run."""

    row: Row
    parameters: Sequence[Row] = ()
    result: bytes | None = None


def now() -> datetime:
    """The present time as in the column `started`: UTC, without a zone."""
    return datetime.now(UTC).replace(tzinfo=None)


def worker_name(process: int | None = None) -> str:
    """Value of the column `worker`: host and process, by default this one."""
    return f"{socket.gethostname()}:{os.getpid() if process is None else process}"


def record_of(
    task: Task, opened: Opened, identification: Identification, *, started: datetime
) -> RunRecord:
    """Record of a run with a verdict; `opened` has the true values of a virtual arm."""
    verdict = identification.verdict
    base = failure_of(
        task,
        "; ".join(verdict.reasons),
        exit_code=verdict.exit_code,
        started=started,
        status=verdict.status,
        classes=opened.classes,
    )
    row = {
        **base.row,
        "result": f"results/{task.run}/result.json",
        "identified": [*starmap(label_of, verdict.identified)],
        "not_identified": [*starmap(label_of, verdict.not_identified)],
        "rejected": [*starmap(label_of, verdict.rejected)],
        "validated_rigid": verdict.validated.rigid,
        "validated_elastic": verdict.validated.elastic,
        "suspected": [entry.code for entry in verdict.suspected],
        "warnings": [entry.code for entry in identification.warnings],
    }
    row |= {f"{part}_s": identification.timing_s.get(part) for part in TIMED_PARTS}
    keys = {"run": row["run"], "study": row["study"]}
    parameters = [keys | _parameter_row(entry, opened.truth) for entry in identification.parameters]
    return RunRecord(row, parameters, to_json(to_document(identification)))


def failure_of(
    task: Task,
    message: str,
    *,
    exit_code: int,
    started: datetime,
    status: str = FAILED_STATUS,
    worker: str = "",
    classes: Mapping[str, Any] | None = None,
) -> RunRecord:
    """Record of a run without a verdict; `message` is one sentence, `started` in UTC."""
    return RunRecord(
        task.row()
        | {
            "status": status,
            "exit_code": exit_code,
            "message": message,
            "started": started,
            "seconds": (now() - started).total_seconds(),
            "worker": worker or worker_name(),
            "classes": json.dumps(dict(classes)) if classes else None,
        }
    )


def _parameter_row(p: Parameter, truth: Mapping[Key, float]) -> dict[str, Any]:
    low, high = p.ci95 or (None, None)
    true = truth.get(p.key)
    error = None
    if true and p.value is not None:
        error = 100.0 * (p.value - true) / abs(true)
    return {
        "name": p.name,
        "joint": p.joint,
        "value": p.value,
        "std": p.std,
        "ci95_low": low,
        "ci95_high": high,
        "unit": p.unit,
        "stage": p.stage,
        "true_value": true,
        "error_percent": error,
    }
