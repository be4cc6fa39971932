"""An identified arm for other programs: MuJoCo, URDF, state space, MATLAB, C, JSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from strainwave.domain import Diagnostic
from strainwave.errors import InvalidInput
from strainwave.export.flat import to_c_header, to_json
from strainwave.export.matlab import to_mat, to_script
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import Export, IdentifiedArm, read_result
from strainwave.export.state_space import state_space, to_state_space
from strainwave.export.urdf import to_urdf
from strainwave.io.atomic_files import nearest, write_whole

__all__ = ["FORMATS", "Export", "IdentifiedArm", "export_file", "read_result", "state_space"]

FORMATS = ("mjcf", "urdf", "state-space", "matlab", "c", "json")

_ENDINGS = {
    ".xml": "mjcf",
    ".mjcf": "mjcf",
    ".urdf": "urdf",
    ".mat": "matlab",
    ".m": "matlab",
    ".h": "c",
    ".json": "json",
}
_RENDER: dict[str, Callable[[IdentifiedArm], Export]] = {
    "mjcf": to_mjcf,
    "urdf": to_urdf,
    "state-space": to_state_space,
    "c": to_c_header,
    "json": to_json,
}


def export_file(
    result: Path, out: Path, *, form: str | None = None, study: Path | None = None
) -> tuple[Diagnostic, ...]:
    """Write an identified arm in another program's format.

    Parameters
    ----------
    result : Path
        A result.json.
    out : Path
        The file to write; its folder is made where it does not exist.
    form : str, optional
        One of `FORMATS`; None: by the ending of `out`. MATLAB's is a script where `out` ends in
        .m, else a .mat file.
    study : Path, optional
        Where the study file is, if not where the result says.

    Returns
    -------
    tuple of Diagnostic
        What the file's reader must know.

    Raises
    ------
    InvalidInput
        A file or the format is at fault, or a parameter the format needs is null.
    """
    form = _chosen(form, out)
    arm = read_result(result, study)
    if out.resolve() in (result.resolve(), arm.study.path.resolve()):
        raise InvalidInput(
            "would write over the file it reads", where=f"--out {out}", remedy="choose another name"
        )
    if out.is_dir() or not out.name:
        raise InvalidInput("is a directory", where=f"--out {out}", remedy="name a file in it")
    if form == "matlab":
        export = to_script(arm) if out.suffix == ".m" else to_mat(arm)
    else:
        export = _RENDER[form](arm)
    write_whole(out.parent, {out.name: export.data})
    return export.warnings


def _chosen(form: str | None, out: Path) -> str:
    listed = ", ".join(FORMATS)
    if form is None and out.suffix not in _ENDINGS:
        raise InvalidInput(
            f"the ending {out.suffix!r} names no format",
            where=f"--out {out}",
            remedy=f"give --format: {listed}",
        )
    chosen = form or _ENDINGS[out.suffix]
    if chosen not in FORMATS:
        raise InvalidInput(
            f"there is no format {chosen!r}",
            where="--format",
            remedy=f"use one of {listed}{nearest(chosen, FORMATS)}",
        )
    return chosen
