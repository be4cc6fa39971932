"""Runs as rows of the tables of a store, whose types do not depend on the values."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import starmap
from typing import Any

import pyarrow as pa

from strainwave.campaign.study_files import Opened
from strainwave.campaign.tasks import FAILED_STATUS, Task
from strainwave.domain import Identification, Parameter
from strainwave.domain.keys import Key, label_of
from strainwave.io.results import to_document, to_json

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
class Record:
    """Row, parameters and result of a run."""

    row: Row
    parameters: Sequence[Row] = ()
    result: bytes | None = None

    @property
    def run(self) -> str:
        """Name of the run."""
        return str(self.row["run"])


def now() -> datetime:
    """The present time as in the column `started`: UTC, without a zone."""
    return datetime.now(UTC).replace(tzinfo=None)


def worker_name(process: int | None = None) -> str:
    """Value of the column `worker`: host and process, by default this one."""
    return f"{socket.gethostname()}:{os.getpid() if process is None else process}"


def record_of(
    task: Task, opened: Opened, identification: Identification, *, started: datetime
) -> Record:
    """Record of a run with a verdict; `opened` has the true values of a virtual arm."""
    verdict = identification.verdict
    task_row = task.row()
    row = task_row | {
        "status": verdict.status,
        "exit_code": verdict.exit_code,
        "message": "; ".join(verdict.reasons),
        "started": started,
        "seconds": (now() - started).total_seconds(),
        "worker": worker_name(),
        "result": f"results/{task.run}/result.json",
        "identified": [*starmap(label_of, verdict.identified)],
        "not_identified": [*starmap(label_of, verdict.not_identified)],
        "rejected": [*starmap(label_of, verdict.rejected)],
        "validated_rigid": verdict.validated.rigid,
        "validated_elastic": verdict.validated.elastic,
        "suspected": [entry.code for entry in verdict.suspected],
        "warnings": [entry.code for entry in identification.warnings],
        "classes": json.dumps(dict(opened.classes)) if opened.classes else None,
    }
    row |= {f"{part}_s": identification.timing_s.get(part) for part in TIMED_PARTS}
    keys = {"run": task_row["run"], "study": task_row["study"]}
    parameters = [keys | _parameter_row(entry, opened.truth) for entry in identification.parameters]
    return Record(row, parameters, to_json(to_document(identification)))


def failure_of(
    task: Task,
    message: str,
    *,
    exit_code: int,
    started: datetime,
    status: str = FAILED_STATUS,
    worker: str = "",
    classes: Mapping[str, Any] | None = None,
) -> Record:
    """Record of a run without a verdict; `message` is one sentence, `started` in UTC."""
    return Record(
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
