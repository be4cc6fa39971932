"""Page "Study": experiments, logs that become further ones, and rig values of other studies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

import tomlkit
from starlette.requests import Request

from strainwave.errors import InvalidInput
from strainwave.init import draft_study
from strainwave.init.changes import (
    KeyChange,
    changed_text,
    parse_draft,
    read_draft,
    read_study_text,
    table_of,
    table_texts,
    tables_of,
)
from strainwave.init.rig_values import rig_changes
from strainwave.io.system import relative_path
from strainwave.workbench.pages.import_logs import logs_in
from strainwave.workbench.pages.overview import columns_by_record
from strainwave.workbench.study_form import shown
from strainwave.workbench.web import Body, Routes, message_of, study_file_of, text_of, workspace_of

routes = Routes()

_USES = (  # value and text of a choice
    ("motion", "motion: motion of the arm, for the rigid model"),
    ("frequency", "frequency: test signal of one joint, for its elasticity"),
    ("sweep", "sweep: the same signal with a smaller amplitude"),
    ("tuning", "tuning: step of one joint, for the final fit"),
    ("check", "check: validation, predicted and never fitted"),
)
_CELLS = {  # title and kind of a key
    "name": ("Name", "text"),
    "file": ("File", "choice"),  # of the logs of the folder
    "use": ("Use", "choice"),
    "joint": ("Joint", "number"),
    "control": ("Control", "text"),
    "start": ("Start [s]", "number"),
    "stop": ("Stop [s]", "number"),
}


def experiments_of(document: tomlkit.TOMLDocument) -> list[dict[str, Any]]:
    """The experiments as rows of a form: a cell for each key, and the text to duplicate one."""
    tables = tables_of(document, "experiment")
    texts = table_texts(tomlkit.dumps(document), "experiment")
    rows = []
    for index, table in enumerate(tables):
        cells = [
            {"place": ["experiment", index, key], "value": shown(table.get(key)), "title": title}
            | {"kind": kind, "choices": _USES if key == "use" else [], "is_list": key == "control"}
            for key, (title, kind) in _CELLS.items()
        ]
        text = texts[index] if len(texts) == len(tables) else ""
        rows.append({"name": str(table.get("name", "")), "text": text, "cells": cells})
    return rows


@routes.get("/api/experiments/{study:path}")
def list_sources(request: Request) -> object:
    """Logs of the study's folder, and the studies that may lend their rig values."""
    path, workspace = study_file_of(request), workspace_of(request)
    others = [name for name in workspace.studies() if name != workspace.relative(path)]
    return {"logs": logs_in(path.parent), "studies": others}


@routes.post("/api/experiments/{study:path}")
def propose_experiments(request: Request, body: Body) -> object:
    """Changes of the study that add logs of its folder, by the rules of `strainwave init`.

    A log whose use cannot be guessed is added as a motion, with a note.
    """
    path, workspace, names = study_file_of(request), workspace_of(request), body.get("logs")
    if not isinstance(names, list) or not names:
        raise InvalidInput("no log is chosen", remedy="choose a log of the folder, or drop one")
    document = read_draft(path).unwrap()
    urdf = table_of(document, "arm").get("urdf")
    robot = workspace.file_of(path, urdf) if isinstance(urdf, str) else None
    tables, n_joints = tables_of(document, "experiment"), len(tables_of(document, "joint"))
    taken = {str(table.get("name")) for table in tables}
    logs = [workspace.file_of(path, str(name)) for name in names]
    changes, notes = list[dict[str, Any]](), list[str]()
    for text, fault in _drafts(logs, path, robot, n_joints):
        entry = parse_draft(text, path).unwrap()
        numbered = chain([entry["name"]], (f"{entry['name']} ({k})" for k in count(2)))
        name = next(each for each in numbered if each not in taken)
        taken.add(name)
        value = changed_text(text, [KeyChange(("name",), name)], path)
        place = ["experiment", len(tables) + len(changes)]
        changes.append({"place": place, "kind": "text", "value": value})
        why = f", not guessed: {message_of(request, fault)}" if fault else ""
        notes.append(f"{name} ({entry['use']}{why})")
    return {"changes": changes, "notes": notes}


def _drafts(
    logs: Sequence[Path], study: Path, urdf: Path | None, n_joints: int
) -> Iterator[tuple[str, InvalidInput | None]]:
    """The text of an experiment for each log, and the reason why its use is no guess."""
    try:
        draft = draft_study(logs, study, urdf)
        if draft.joints != n_joints:
            raise InvalidInput(f"the columns are those of {draft.joints} joint(s)")
        yield from ((text, None) for text in table_texts(draft.text, "experiment"))
    except InvalidInput as error:
        if len(logs) > 1:
            for log in logs:
                yield from _drafts([log], study, urdf, n_joints)
        else:
            name, file = logs[0].name.split(".")[0], relative_path(logs[0], study.parent)
            yield tomlkit.dumps({"name": name, "file": file, "use": "motion"}), error


@routes.post("/api/rig-values/{study:path}")
def propose_rig_values(request: Request, body: Body) -> object:
    """Changes that give the study the rig values of another `study`, or of a text with `values`."""
    path, workspace = study_file_of(request), workspace_of(request)
    lender = text_of(body, "study", "")
    values = read_study_text(workspace.study_file(lender)) if lender else text_of(body, "values")
    text = read_study_text(path)
    columns = chain.from_iterable(columns_by_record(request, parse_draft(text, path)).values())
    changes = rig_changes(text, values, set(columns), path)
    return {"changes": [{"place": c.place, "kind": "text", "value": c.value} for c in changes]}
