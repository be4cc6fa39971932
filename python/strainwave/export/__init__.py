"""Export of an identified arm: simulators, URDF, state space, MATLAB, C, JSON."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput, suggest_name
from strainwave.export.actuators import to_actuators
from strainwave.export.completion import completed
from strainwave.export.flat import to_c_header, to_json, to_mat, to_script
from strainwave.export.linear_models import LinearArm, linear_arm, state_space, to_state_space
from strainwave.export.mjcf import to_mjcf
from strainwave.export.mjcf_drives import Target
from strainwave.export.randomisation import drawn_arms, to_randomisation
from strainwave.export.sdf import to_drake, to_sdf
from strainwave.export.simscape import to_simscape
from strainwave.export.source import Export, IdentifiedArm, arm_of, read_arm
from strainwave.export.urdf import to_srdf, to_urdf
from strainwave.export.usd import to_usd
from strainwave.io.atomic_files import write_whole
from strainwave.io.results import result_path

__all__ = [
    "FORMATS",
    "Export",
    "IdentifiedArm",
    "LinearArm",
    "arm_of",
    "export_arm",
    "export_file",
    "linear_arm",
    "read_arm",
    "state_space",
]

_FORMAT_BY_ENDING = {
    ".xml": "mjcf",
    ".mjcf": "mjcf",
    ".urdf": "urdf",
    ".srdf": "srdf",
    ".usda": "usd",
    ".usd": "usd",
    ".sdf": "sdf",
    ".mat": "matlab",
    ".m": "matlab",
    ".h": "c",
    ".json": "json",
}
_RENDERERS: dict[str, Callable[[IdentifiedArm], Export]] = {
    "mjcf": to_mjcf,
    "urdf": to_urdf,
    "srdf": to_srdf,
    "usd": to_usd,
    "sdf": to_sdf,
    "drake": to_drake,
    "simscape": to_simscape,
    "isaaclab": partial(to_actuators, form="isaaclab"),
    "mjlab": partial(to_actuators, form="mjlab"),
    "pace": partial(to_actuators, form="pace"),
    "state-space": to_state_space,
    "matlab": to_mat,
    "c": to_c_header,
    "json": to_json,
}
FORMATS = tuple(_RENDERERS)


def export_file(
    result: Path, out: Path, *, form: str | None = None, study: Path | None = None, **options: Any
) -> Export:
    """Write the arm of a result.json, or of a directory with one; see `export_arm`."""
    arm = read_arm(result, study)
    inputs = (result_path(result), arm.study.path)
    return export_arm(arm, out, form=form, inputs=inputs, **options)


def export_arm(
    arm: IdentifiedArm,
    out: Path,
    *,
    form: str | None = None,
    inputs: tuple[Path, ...] = (),
    randomise: int = 0,
    seed: int = 0,
    mujoco: str | None = None,
) -> Export:
    """Write an identified arm in the format of another program.

    `form` is one of `FORMATS`; by default the ending of `out` decides. MATLAB gets a script if
    `out` ends in .m, else a MAT-file. `out` may not be one of `inputs`. With `randomise`, as many
    arms drawn from the joint covariance follow in files out-1, out-2, ..., and their distribution
    in out.randomisation.json; they are equal for equal `seed`. `mujoco` is the version that an MJCF
    is for; by default the newest. Returns the export with its
    warnings and notes. Raises `InvalidInput` if a file or the format is invalid, or a parameter
    that the format needs is missing, and `NotIdentifiable` if no arms can be drawn.
    """
    if form is None and out.suffix not in _FORMAT_BY_ENDING:
        raise InvalidInput(
            f"the ending {out.suffix!r} does not determine a format",
            where=f"--out {out}",
            remedy=f"give --format: {', '.join(FORMATS)}",
        )
    form = form or _FORMAT_BY_ENDING[out.suffix]
    if form not in FORMATS:
        raise InvalidInput(
            f"there is no format {form!r}",
            where="--format",
            remedy=f"use one of {', '.join(FORMATS)}{suggest_name(form, FORMATS)}",
        )
    if (urdf := arm.study.arm.urdf) is not None:
        inputs = (*inputs, arm.study.path.parent / urdf.file)
    if out.resolve() in [path.resolve() for path in inputs]:
        raise InvalidInput(
            "would overwrite an input file", where=f"--out {out}", remedy="choose another name"
        )
    if out.is_dir() or not out.name:
        raise InvalidInput("is a directory", where=f"--out {out}", remedy="name a file in it")
    if randomise < 0:
        raise InvalidInput(
            f"{randomise} arms cannot be drawn", where="--randomise", remedy="give 0 or more"
        )
    render = to_script if form == "matlab" and out.suffix == ".m" else _RENDERERS[form]
    complete = partial(completed, form=form)
    if form == "mjcf":
        target = Target.of(mujoco) if mujoco else Target()
        render = partial(to_mjcf, target=target)
        complete = partial(complete, held=target.effects, has_powers=target.has("polynomial"))
    elif mujoco:
        raise InvalidInput(
            "is the version of another format", where="--mujoco", remedy="export to mjcf"
        )
    draws = drawn_arms(arm, randomise, seed) if randomise else ()
    drawn = tuple(map(complete, draws))
    export = render(replace(complete(arm), draws=drawn))
    names = [f"{out.stem}-{k:0{len(str(randomise))}}{out.suffix}" for k in range(1, randomise + 1)]
    files = {out.name: export.data}
    files |= {name: render(each).data for name, each in zip(names, drawn, strict=True)}
    if draws:
        distribution = to_randomisation(arm, draws, seed, names)
        files[f"{out.stem}.randomisation.json"] = distribution
    write_whole(out.parent, files)
    read_back = export.check(out) if export.check else None
    return replace(
        export,
        warnings=export.warnings + (read_back.warnings if read_back else ()),
        read_back=read_back,
    )
