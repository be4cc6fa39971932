"""Page "Check": whether logs and study agree, with remedies.

It is the gate before an estimate: the check must pass, or be overridden, for this very input. The
last check of a study is stored next to its runs, with a fingerprint of the study file and its logs.
Any change of them closes the gate again.
"""

from __future__ import annotations

import json
import re
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave import pipeline
from strainwave.domain import Clause
from strainwave.domain.messages import text_of as message_text
from strainwave.domain.results.consistency import Correction
from strainwave.errors import InvalidInput
from strainwave.init.changes import correction_changes, edit_study
from strainwave.io.atomic_files import decode, write_whole
from strainwave.io.kept_files import fingerprint, log_of, study_at
from strainwave.io.results import check_document, to_json
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import Axis, Figure, line_panel
from strainwave.report.plotly_backend import plotly
from strainwave.workbench.web import Body, Routes, message_of, page, study_of
from strainwave.workbench.workspace import runs_folder

_STORED = ".check.json"
_HEADER = re.compile(r"\[\[?(joint|experiment|arm|servo|transmission)\]\]?")  # of a table

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


def run_check(path: Path) -> None:
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


def require_open(path: Path) -> Gate:
    """The gate of a study; raises InvalidInput if an estimate must not start."""
    gate = gate_of(path)
    if not gate.is_open:
        raise InvalidInput(gate.reason, where=path.name, remedy="open the page Check")
    return gate


def _read(path: Path) -> _Stored | None:
    try:
        stored = _Stored(**json.loads((runs_folder(path) / _STORED).read_bytes()))
        _shown_document(deepcopy(stored.document), "")  # fails if it is damaged
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return stored if isinstance(stored.document.get("status"), str) else None


def _write(path: Path, stored: _Stored) -> None:
    write_whole(runs_folder(path), {_STORED: to_json(asdict(stored))})


routes = Routes()


@routes.page("/check/{study:path}")
def _show_check(request: Request) -> Response:
    return page(request, "check", "Check")


@routes.get("/api/check/{study:path}")
def read_gate(request: Request) -> object:
    """The last check, if it is still valid."""
    return _shown(request, study_of(request))


@routes.post("/api/check/{study:path}")
def check_now(request: Request, _body: Body) -> object:
    """Check the study."""
    run_check(study_of(request))
    return _shown(request, study_of(request))


@routes.post("/api/override-check/{study:path}")
def override(request: Request, _body: Body) -> object:
    """Allow an estimate in spite of a suspected fault."""
    path = study_of(request)
    stored = _read(path)
    if stored is None or gate_of(path).state != "suspected":
        raise InvalidInput("there is no check to override", remedy="check the study first")
    _write(path, replace(stored, is_overridden=True))
    return _shown(request, path)


@routes.post("/api/apply-remedy/{study:path}")
def apply_remedy(request: Request, body: Body) -> object:
    """Write the corrections of a suspected fault to the study file, and check again."""
    path = study_of(request)
    document = gate_of(path).document
    index = body.get("index")
    if document is None or not isinstance(index, int):
        raise InvalidInput("the study has changed since the check", remedy="check it again")
    if index not in range(len(document["suspected"])):
        raise InvalidInput("the check suspects no such fault", remedy="check the study again")
    entries = document["suspected"][index]["corrections"]
    text = decode(path.read_bytes(), path)
    changes = correction_changes(text, [Correction(**entry) for entry in entries])
    if not changes:
        raise InvalidInput("the study file cannot correct this fault", remedy="correct the logs")
    edit_study(path, changes)
    run_check(path)
    return _shown(request, path)


@routes.get("/api/check-signal/{study:path}")
def show_channel(request: Request) -> object:
    """A channel of one record over time."""
    path, name = study_of(request), request.query_params.get("channel", "")
    study = study_at(path)
    wanted = request.query_params.get("experiment") or study.experiments[0].name
    log = log_of(path, wanted)
    if name not in log.channels:
        raise InvalidInput(f"the record {wanted!r} has no channel {name!r}")
    has_servo = study.arm.position_servo is not None
    title = f"{name} [{unit_of(name, study.arm.joints, commands_angles=has_servo)}]"
    panel = line_panel(title, log.time, log.channels[name], name)
    return plotly(Figure(Axis("time [s]"), (panel,)))


def _shown(request: Request, path: Path) -> dict[str, Any]:
    """The gate and the check."""
    gate = gate_of(path)
    reason = message_of(request, gate.reason)
    shown: dict[str, Any] = asdict(gate) | {"is_open": gate.is_open, "reason": reason}
    if gate.document is not None:
        shown["document"] = _shown_document(gate.document, decode(path.read_bytes(), path))
    return shown


def _shown_document(document: dict[str, Any], text: str) -> dict[str, Any]:
    """A check with merged relations; each suspected fault has evidence, and fields to correct."""
    relations = _merged(document["relations"])
    contradictions = [relation for relation in relations if not relation["consistent"]]
    for each in document["suspected"]:
        each["fields"] = _fields(text, each)
        near = [one for one in contradictions if _joints(one) & _joints(each)]
        each["evidence"] = near or contradictions
        each["places"] += [place for one in each["evidence"] for place in one["places"]]
        each["remedy"] = _HEADER.sub(r"\1", each["remedy"])
        each["lines"] = [
            f"{c['table']} {c['entry']} {c['key']} = {c['value']}".replace("  ", " ")
            for c in each["corrections"]
            if c["table"] != "log"
        ]
    return document | {"relations": relations}


def _joints(entry: dict[str, Any]) -> set[str]:
    """Numbers of the joints that a fault or a relation concerns."""
    names = (place["joint"] or place["channel"] or "" for place in entry["places"])
    return {number for name in names for number in re.findall(r"\d+$", str(name))}


def _fields(text: str, suspicion: dict[str, Any]) -> list[str]:
    """Fields of the page Study that a fault concerns, first those of its corrections."""
    corrections = [Correction(**entry) for entry in suspicion["corrections"]]
    if suspicion["code"] == "wrong-gear-ratio":
        joints = sorted(_joints(suspicion))
        corrections += [Correction("joint", joint, "gear_ratio", None) for joint in joints]
    for place in suspicion["places"]:
        joint, channel, key, names = (place[k] for k in ("joint", "channel", "key", "experiments"))
        table: Any = "joint" if joint else "arm"
        entry = str(joint or "")
        if channel:
            table, entry, key = "channels", channel, "scale"
        elif key and names:
            table, entry = "experiment", names[0]
        if key:
            corrections.append(Correction(table, entry, key, None))
    places = [map(str, change.place) for change in correction_changes(text, corrections)]
    return list(dict.fromkeys(map("-".join, places)))


def _merged(relations: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Relations with equal numbers as one row, contradictions first."""
    rows: dict[tuple[object, ...], dict[str, Any]] = {}
    for each in sorted(relations, key=lambda each: each["consistent"]):
        text = message_text(Clause(f"relation/{each['relation']}"))
        value = each["measured"]
        measured = "" if value is None or not np.isfinite(value) else f"{value:.4g}"
        expected = "> 0" if each["expected"] is None else f"{each['expected']:g}"
        row: dict[str, Any] = {"text": text, "measured": measured, "expected": expected}
        row["consistent"] = each["consistent"]
        row = rows.setdefault(tuple(row.values()), row | {"where": [], "places": []})
        row["where"].append(each["where"])
        row["places"] += each["places"]
    return list(rows.values())
