"""First page: the studies of the folder."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.io.kept_files import study_at
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Routes, message_of, page, workspace_of

routes = Routes()

MARKS = {"determined": "good", "partly-determined": "doubt", "not-determined": "bad"}
"""Colour of the status of a result."""


@routes.page("/")
def show_home(request: Request) -> Response:
    """The studies of the folder."""
    rows = [_row(request, name) for name in workspace_of(request).studies()]
    return page(request, "home", "Studies", studies=rows)


def _row(request: Request, name: str) -> dict[str, Any]:
    """A study file: its arm, or its error, and the verdict of the latest finished run."""
    runs: list[Run] = []
    try:
        path = workspace_of(request).study(name)
        runs = Runs(path).all()
        study = study_at(path)
        arm = study.arm
        springs = ", ".join(dict.fromkeys(joint.spring for joint in arm.joints))
        plural = "s" if arm.n_joints > 1 else ""
        description = (
            f"{arm.kind.replace('-', ' ')}, {arm.n_joints} joint{plural} ({springs}),"
            f" {len(study.experiments)} records"
        )
        is_valid = True
    except InvalidInput as error:
        description, is_valid = message_of(request, error), False
    finished = [run for run in runs if run.kind == "identify" and run.state == "done"]
    status = (finished[-1].status or "no result") if finished else ""
    row = {"path": name, "description": description, "is_valid": is_valid, "runs": len(runs)}
    latest = finished[-1].ended if finished else None
    return row | {"status": status, "mark": MARKS.get(status, ""), "ended": (latest or "")[:10]}
