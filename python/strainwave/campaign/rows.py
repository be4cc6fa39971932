"""Runs as rows of the tables of a store."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import starmap
from typing import Any

from strainwave.campaign.cases import Opened
from strainwave.campaign.schema import TIMED_PARTS
from strainwave.campaign.store import Record
from strainwave.campaign.tasks import FAILED_STATUS, Task
from strainwave.domain import Identification, Parameter
from strainwave.domain.keys import Key, label_of
from strainwave.io.results import to_document, to_json


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
