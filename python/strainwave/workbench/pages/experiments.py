"""Experiments of a study, on page "Study"."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from strainwave.domain import Use
from strainwave.workbench.study_edit import tables_of
from strainwave.workbench.web import Routes

routes = Routes()

_EXPERIMENT = (  # key, title, kind, choices, and whether the value is a list of texts
    ("name", "Name", "text", (), False),
    ("file", "File", "text", (), False),
    ("use", "Use", "choice", get_args(Use), False),
    ("joint", "Joint", "number", (), False),
    ("control", "Control", "text", (), True),
    ("start", "Start [s]", "number", (), False),
    ("stop", "Stop [s]", "number", (), False),
)


def experiments_of(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The experiments as rows of a form: a cell for each key."""
    rows = []
    for index, experiment in enumerate(tables_of(document, "experiment")):
        cells = []
        for key, title, kind, choices, is_list in _EXPERIMENT:
            value = experiment.get(key)
            shown = ", ".join(map(str, value)) if isinstance(value, list) else value
            cells.append(
                {
                    "place": ["experiment", index, key],
                    "title": title,
                    "kind": kind,
                    "choices": choices,
                    "value": "" if shown is None else str(shown),
                    "is_list": is_list,
                }
            )
        rows.append({"name": str(experiment.get("name", "")), "cells": cells})
    return rows
