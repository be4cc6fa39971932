"""Records and results of runs that did not run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from strainwave.workbench.runs import Runs


def parameter(name: str, joint: int | None, value: float, half: float) -> dict[str, Any]:
    """A parameter of a result with its 95 % interval."""
    entry = {"name": name, "joint": joint, "value": value, "std": half / 1.96, "unit": "N m/rad"}
    return entry | {"stage": "tuned", "ci95": [value - half, value + half]}


def result_of(stiffness: float = 6000.0, fits: tuple[float | None, ...] = (98.0, 90.0)) -> Any:
    """A result.json with what a table shows."""
    return {
        "status": "determined",
        "parameters": [
            parameter("gear_stiffness", 1, stiffness, 12.0),
            parameter("alpha", None, 1.6, 0.1),
        ],
        "checks": [
            {"experiment": "check", "fit_percent": {f"y{k}": fit for k, fit in enumerate(fits)}}
        ],
        "options": {"links": {"order": 2, "time_constant": 0.2}, "accept": []},
        "study": {"arm": {"kind": "planar-two-link"}, "joint": [{"gear_ratio": 0.01}]},
    }


def add_run(study: Path, name: str, result: Any = None, **values: Any) -> Path:
    """The folder of a run with a record, and with a result if one is given."""
    folder = Runs(study).prepare(name)
    record = {"name": name, "kind": "identify", "state": "done", "status": "determined"} | values
    record.setdefault("commands", [["identify", "study.toml", "--out", "."]])
    record.setdefault("created", "2026-11-01T10:00:00.000+00:00")
    (folder / "run.json").write_text(json.dumps(record))
    if result is not None:
        text = result if isinstance(result, str) else json.dumps(result)
        (folder / "result.json").write_text(text)
        (folder / "report.html").write_text(f"<h1>{name}</h1>")
    return folder
