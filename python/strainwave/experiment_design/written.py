"""Files of a design: tables, a C header, trajectories, predicted intervals, the study file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from strainwave.domain import FloatArray, Study
from strainwave.dynamics.arm import Arm
from strainwave.experiment_design.command_table import applied_columns, table_name
from strainwave.experiment_design.joint_trajectory import trajectory_name, trajectory_text
from strainwave.experiment_design.plan import Design, Planned
from strainwave.experiment_design.rigid_precision import torque_errors_of
from strainwave.io.atomic_files import write_whole
from strainwave.io.results import base_parameter_entries, parameter_entry, to_json
from strainwave.io.study import copy_to, write_study
from strainwave.io.templates import fill_text

HEADER_FILE = "excitation.h"
PRECISION_FILE = "predicted.json"


def write(design: Design, folder: Path) -> None:
    """Write tables, trajectories, the header, predictions, and study.toml, whose logs are missing.

    Creates the folder. Raises InvalidInput if it cannot be written.
    """
    study = copy_to(design.study, folder)
    contents = {name: text.encode() for name, text in _texts(design).items()}
    write_whole(folder, contents)
    write_study(study, study.path)


def _texts(design: Design) -> dict[str, str]:
    """Contents of the files of a design, by name."""
    texts = {
        table_name(record.experiment): _csv(_columns(design.study, record))
        for record in design.records
    }
    names = design.study.arm.joint_names
    texts |= {
        trajectory_name(record.experiment): trajectory_text(names, record.waypoints)
        for record in design.records
        if record.waypoints is not None
    }
    return texts | {HEADER_FILE: _c_header(design), PRECISION_FILE: _predicted(design)}


def _predicted(design: Design) -> str:
    """Predicted parameters with intervals, in the layout of result.json."""
    rigid = design.records[0].precision
    base = base_parameter_entries(design.study.arm, rigid)
    final = {p.key: p for p in (*rigid, *design.precision)}  # the whole-arm fit comes last
    errors = torque_errors_of(Arm.of(design.study.arm), design.torque_errors)
    sources = [
        "measured" if i in design.torque_errors else "assumed" for i in range(1, len(errors) + 1)
    ]
    document = {
        "torque_errors": [
            {"joint": i, "value": error, "source": source}
            for i, (error, source) in enumerate(zip(errors.tolist(), sources, strict=True), start=1)
        ]
    }
    document |= {"parameters": [parameter_entry(p) for p in final.values()]} | (
        {"base_parameters": base} if base else {}
    )
    return to_json(document).decode()


def _columns(study: Study, record: Planned) -> dict[str, FloatArray]:
    return applied_columns(study.arm, record.experiment, record.drive, record.motor_angle)


def _csv(columns: dict[str, FloatArray]) -> str:
    rows = map(_row, zip(*columns.values(), strict=True))
    return "\n".join([",".join(columns), *rows, ""])


def _row(values: Iterable[float]) -> str:
    return ",".join(f"{value:.9g}" for value in values)


def _c_header(design: Design) -> str:
    """All columns except time as C arrays, and the tick of each record."""
    records = [
        (re.sub(r"\W", "_", record.experiment.name), record.drive, _columns(design.study, record))
        for record in design.records
    ]
    return fill_text(Path(__file__).with_name("excitation.h.j2"), records=records, row=_row)
