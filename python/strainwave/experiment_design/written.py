"""Files of a design: tables, a C header with the same arrays, and the study file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from strainwave.domain import FloatArray, Study
from strainwave.experiment_design.command_table import applied_columns, table_name
from strainwave.experiment_design.plan import Design, Planned
from strainwave.io.atomic_files import write_whole
from strainwave.io.study import write_study

HEADER_FILE = "excitation.h"
_VALUES_PER_LINE = 8  # of the C header


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
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def _c_header(design: Design) -> str:
    """All columns except time as C arrays, and the tick of each record."""
    parts = [
        "/* Experiments designed by strainwave. SI units, one value per tick. The voltage of a",
        "   joint without an array is zero; under a servo its velocity reference is zero. */",
        "#ifndef STRAINWAVE_EXCITATION_H",
        "#define STRAINWAVE_EXCITATION_H",
    ]
    for record in design.records:
        name = re.sub(r"\W", "_", record.experiment.name)
        columns = _columns(design.study, record)
        time, *values = columns.items()
        parts += [
            "",
            f"#define {name.upper()}_TICKS {len(time[1])}",
            f"#define {name.upper()}_TICK_SECONDS {record.drive.tick:.9g}",
        ]
        for column, array in values:
            channel, unit = column.split(" ", 1)
            parts.append(f"static const double {name}_{channel}[{len(array)}] = {{ /* {unit} */")
            texts = [f"{value:.9g}" for value in array]
            parts += [
                ",".join(texts[k : k + _VALUES_PER_LINE]) + ","
                for k in range(0, len(texts), _VALUES_PER_LINE)
            ]
            parts.append("};")
    return "\n".join([*parts, "", "#endif", ""])
