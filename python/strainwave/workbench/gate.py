"""The gate before an estimate: the input check must pass, or be overridden, for this very input.

The last check of a study is stored next to its runs, with a fingerprint of the study file and its
logs. Any change of them closes the gate again.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from strainwave import pipeline
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole
from strainwave.io.results import check_document, to_json
from strainwave.workbench.cached_files import fingerprint, study_at
from strainwave.workbench.workspace import runs_folder

GateState = Literal["unchecked", "consistent", "suspected", "overridden", "invalid"]

REASONS: dict[GateState, str] = {
    "unchecked": "The study has changed since the last check, or was never checked.",
    "consistent": "Logs and study agree.",
    "suspected": "The check suspects a fault of the input. Correct it, or override the check.",
    "overridden": "The check suspects a fault of the input and was overridden.",
    "invalid": "The study has an error.",
}


@dataclass(frozen=True, slots=True)
class Gate:
    """The last check of a study, and whether an estimate may start."""

    state: GateState
    reason: str
    document: dict[str, Any] | None = None  # of the check, as `strainwave check --json` prints it

    @property
    def is_open(self) -> bool:
        """Whether an estimate may start."""
        return self.state in ("consistent", "overridden")


@dataclass(frozen=True, slots=True)
class _Stored:
    fingerprint: str
    document: dict[str, Any]
    is_overridden: bool = False


def gate_of(path: Path) -> Gate:
    """The gate of a study file."""
    try:
        current = fingerprint(path)
    except InvalidInput as error:
        return Gate("invalid", str(error))
    stored = _read(path)
    if stored is None or stored.fingerprint != current:
        return Gate("unchecked", REASONS["unchecked"])
    state: GateState = "consistent" if stored.document["status"] == "consistent" else "suspected"
    if state == "suspected" and stored.is_overridden:
        state = "overridden"
    return Gate(state, REASONS[state], stored.document)


def run_check(path: Path) -> Gate:
    """Check the input of a study and store the result.

    Raises InvalidInput if the study or a log is invalid.
    """
    current = fingerprint(path)
    check = pipeline.check_input(study_at(path))
    document = check_document(check)
    for entry, relation in zip(document["relations"], check.relations, strict=True):
        entry["places"] = [asdict(relation.place)]
    for entry, suspicion in zip(document["suspected"], check.suspected, strict=True):
        entry["places"] = [asdict(place) for place in suspicion.places]
    _write(path, _Stored(current, document))
    return gate_of(path)


def override_check(path: Path) -> Gate:
    """Open the gate of a study whose check suspects a fault."""
    stored = _read(path)
    if stored is None or gate_of(path).state != "suspected":
        raise InvalidInput("there is no check to override", remedy="check the study first")
    _write(path, replace(stored, is_overridden=True))
    return gate_of(path)


def require_open(path: Path) -> Gate:
    """The gate of a study; raises InvalidInput if an estimate must not start."""
    gate = gate_of(path)
    if not gate.is_open:
        raise InvalidInput(gate.reason, where=path.name, remedy="open the page Check")
    return gate


def _file(path: Path) -> tuple[Path, str]:
    return runs_folder(path), ".check.json"


def _read(path: Path) -> _Stored | None:
    folder, name = _file(path)
    try:
        stored = _Stored(**json.loads((folder / name).read_bytes()))
        entries = [*stored.document["relations"], *stored.document["suspected"]]
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return stored if all(isinstance(entry, dict) for entry in entries) else None


def _write(path: Path, stored: _Stored) -> None:
    folder, name = _file(path)
    write_whole(folder, {name: to_json(asdict(stored))})
