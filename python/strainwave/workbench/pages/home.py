"""First page: the studies of the folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from strainwave.errors import InvalidInput
from strainwave.workbench.cached_files import study_at
from strainwave.workbench.runs import Runs, status_of
from strainwave.workbench.web import Routes, page, workspace_of

routes = Routes()


@dataclass(frozen=True, slots=True)
class StudyRow:
    """A study file in the list."""

    path: str
    description: str  # of the arm, or the error of the file
    is_valid: bool
    runs: int
    status: str  # verdict of the latest finished identification


@routes.page("/")
def show_home(request: Request) -> Response:
    """The studies of the folder."""
    workspace = workspace_of(request)
    rows = [_row(name, workspace.study(name)) for name in workspace.studies()]
    return page(request, "home", "Studies", studies=rows)


def _row(name: str, path: Path) -> StudyRow:
    runs = Runs(path)
    finished = [run for run in runs.all("identify") if run.state == "done"]
    status = (status_of(runs.path(finished[-1].name)) or "no result") if finished else ""
    try:
        study = study_at(path)
        arm = study.arm
        springs = ", ".join(dict.fromkeys(joint.spring for joint in arm.joints))
        plural = "s" if arm.n_joints > 1 else ""
        description = (
            f"{arm.kind.replace('-', ' ')}, {arm.n_joints} joint{plural} ({springs}),"
            f" {len(study.experiments)} records"
        )
    except InvalidInput as error:
        return StudyRow(name, str(error), False, len(runs.all()), status)
    return StudyRow(name, description, True, len(runs.all()), status)
