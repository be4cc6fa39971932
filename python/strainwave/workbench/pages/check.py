"""Page "Check": whether logs and study agree, with remedies."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import Response

from strainwave.domain import Clause
from strainwave.domain.consistency import Correction
from strainwave.domain.messages import text_of as message_text
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode
from strainwave.presentation.figures import Axis, Colour, Figure, Line, Panel, decimate
from strainwave.presentation.plotly_backend import plotly
from strainwave.presentation.report.predictions import unit_of
from strainwave.workbench.cached_files import log_of, study_at
from strainwave.workbench.gate import Gate, gate_of, override_check, run_check
from strainwave.workbench.study_edit import correction_changes, edit_study
from strainwave.workbench.web import Body, Routes, message_of, page, study_of

routes = Routes()


@routes.page("/check/{study:path}")
def show_check(request: Request) -> Response:
    """The page."""
    return page(request, "check", "Check")


@routes.get("/api/check/{study:path}")
def read_gate(request: Request) -> object:
    """The last check, if it is still valid."""
    return _shown(request, gate_of(study_of(request)))


@routes.post("/api/check/{study:path}")
def check_now(request: Request, _body: Body) -> object:
    """Check the study."""
    return _shown(request, run_check(study_of(request)))


@routes.post("/api/override-check/{study:path}")
def override(request: Request, _body: Body) -> object:
    """Allow an estimate in spite of a suspected fault."""
    return _shown(request, override_check(study_of(request)))


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
    return _shown(request, run_check(path))


@routes.get("/api/check-signal/{study:path}")
def show_channel(request: Request) -> object:
    """A channel of one record over time."""
    path, name = study_of(request), request.query_params.get("channel", "")
    study = study_at(path)
    wanted = request.query_params.get("experiment") or study.experiments[0].name
    log = log_of(path, wanted)
    if name not in log.channels:
        raise InvalidInput(f"the record {wanted!r} has no channel {name!r}")
    values = log.channels[name]
    rows = decimate(values)
    line = Line(log.time[rows], values[rows], name, Colour.MEASURED)
    title = f"{name} [{unit_of(name, study.arm.joints)}]"
    return plotly(Figure(Axis("time [s]"), (Panel(Axis(title), (line,)),)))


def _shown(request: Request, gate: Gate) -> dict[str, Any]:
    """A gate for the page, with the relations that contradict first."""
    reason = message_of(request, gate.reason)
    shown: dict[str, Any] = asdict(gate) | {"is_open": gate.is_open, "reason": reason}
    if gate.document is None:
        return shown
    relations = _merged(gate.document["relations"])
    for each in gate.document["suspected"]:
        in_study = [c for c in each["corrections"] if c["table"] != "log"]
        each["lines"] = [
            f"{c['table']} {c['entry']} {c['key']} = {c['value']}".replace("  ", " ")
            for c in in_study
        ]
    shown["document"] = gate.document | {"relations": relations}
    return shown


def _merged(relations: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Relations with equal numbers as one row, contradictions first."""
    rows: dict[tuple[object, ...], dict[str, Any]] = {}
    for each in sorted(relations, key=lambda each: each["consistent"]):
        text = message_text(Clause(f"relation/{each['relation']}"))
        value = each["measured"]
        measured = "" if value is None or not np.isfinite(value) else f"{value:.4g}"
        expected = "> 0" if each["expected"] is None else f"{each['expected']:g}"
        key = text, measured, expected, each["consistent"]
        row: dict[str, Any] = {"text": text, "measured": measured, "expected": expected}
        row = rows.setdefault(
            key, row | {"consistent": each["consistent"], "where": [], "places": []}
        )
        row["where"].append(each["where"])
        row["places"] += each["places"]
    return list(rows.values())
