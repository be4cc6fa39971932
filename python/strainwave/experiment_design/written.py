"""Files of a design: tables, a C header with the same arrays, and the study file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from strainwave.domain import FloatArray, Study
from strainwave.experiment_design.command_table import applied_columns, table_name
from strainwave.experiment_design.plan import Design, Planned
from strainwave.io.atomic_files import write_whole
from strainwave.io.study import write_study
from strainwave.io.templates import fill_text

HEADER_FILE = "excitation.h"


def write(design: Design, folder: Path) -> None:
    """Write one table per record, the header, and study.toml, whose logs do not exist yet.

    Creates the folder. Raises InvalidInput if it cannot be written.
    """
    contents = {
        table_name(record.experiment): _csv(_columns(design.study, record)).encode()
        for record in design.records
    }
    contents[HEADER_FILE] = _c_header(design).encode()
    write_whole(folder, contents)
    study = replace(design.study, path=folder / "study.toml")
    write_study(study, study.path)


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
