"""What a worker is given, and what it answers: one line of JSON each."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from strainwave import __version__
from strainwave.campaign.cases import Case
from strainwave.campaign.kinds import from_json, to_json
from strainwave.campaign.store import Recorded

FAILED = "failed"
"""Status of a run without a verdict: its input is at fault, or it crashed or took too long."""


@dataclass(frozen=True)
class Limits:
    """What a run may take."""

    time_s: float = 600.0
    memory_mib: int | None = None  # address space; None: no limit
    tasks: int = 100  # of one worker process, which is replaced then


@dataclass(frozen=True, kw_only=True)
class Task:
    """A case, what to do with it, and where its run goes."""

    case: Case
    study_sha256: str | None
    inputs_sha256: str
    stages: tuple[str, ...]
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    store: str  # absolute path, or URL
    campaign: str
    version: str = __version__

    @property
    def options_sha256(self) -> str:
        """Of stages and options."""
        return _digest([self.stages, self.options])

    @property
    def run(self) -> str:
        """The same for the same work: case, study, logs, options and version."""
        identity = [self.case.name, self.study_sha256, self.inputs_sha256]
        return _digest([*identity, self.options_sha256, self.version])[:32]

    def row(self) -> dict[str, Any]:
        """The columns of a run's row that are known before it runs."""
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
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return json.dumps(own | {"case": to_json(self.case)})

    @classmethod
    def from_json(cls, text: str) -> Task:
        """The task of a line."""
        own = json.loads(text)
        own |= {"case": from_json(own["case"]), "stages": tuple(own["stages"])}
        return cls(**own)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run ended, for the driver; the store has the rest."""

    run: str
    study: str
    status: str
    exit_code: int
    message: str = ""
    seconds: float = 0.0
    skipped: bool = False  # recorded before
    unrecorded: str = ""  # why the store does not have it

    @classmethod
    def of(cls, run: str, study: str, known: Recorded, *, skipped: bool = False) -> Outcome:
        """The outcome of a run that the store has."""
        return cls(
            run=run,
            study=study,
            status=known.status,
            exit_code=known.exit_code,
            message=known.message,
            skipped=skipped,
        )

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        """The outcome of a line."""
        return cls(**json.loads(text))


def merged(
    tables: Sequence[Mapping[str, Mapping[str, Any]]],
) -> dict[str, dict[str, Any]]:
    """Tables of options over one another, the later winning.

    Parameters
    ----------
    tables : sequence of mapping
        Stage -> key -> value.

    Returns
    -------
    dict
    """
    found: dict[str, dict[str, Any]] = {}
    for table in tables:
        for stage, own in table.items():
            found.setdefault(stage, {}).update(own)
    return found


def _digest(values: object) -> str:
    """SHA-256 of plain JSON values."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()
