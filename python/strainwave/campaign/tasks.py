"""Tasks of a worker and their outcomes, one line of JSON each."""

from __future__ import annotations

import hashlib
import json
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from strainwave import __version__
from strainwave.campaign.study_files import Case
from strainwave.domain import Stage

FAILED_STATUS = "failed"
"""Status of a run without a verdict: wrong input, a crash, or the time limit."""


@dataclass(frozen=True)
class Limits:
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


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a run for the driver; the store has the whole record."""

    run: str
    study: str
    status: str
    exit_code: int
    message: str = ""
    seconds: float = 0.0
    skipped: bool = False  # recorded before
    unrecorded: str = ""  # reason why it is not in the store

    @classmethod
    def of(cls, row: Mapping[str, Any], *, skipped: bool = False, unrecorded: str = "") -> Outcome:
        """The outcome of a row of the runs."""
        columns = ("run", "study", "status", "exit_code", "message", "seconds")
        values = {name: row[name] for name in columns}
        return cls(**values, skipped=skipped, unrecorded=unrecorded)

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        """The outcome of a line."""
        return cls(**json.loads(text))


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
