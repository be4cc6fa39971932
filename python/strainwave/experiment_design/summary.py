"""What a person reads in the terminal after a design."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.domain import Study
from strainwave.experiment_design.command_table import table_name
from strainwave.experiment_design.plan import Design, Planned, clock_of
from strainwave.experiment_design.written import HEADER

_NAMES = ("gear_stiffness", "gear_damping", "motor_inertia", "link_inertia")


def print_design(design: Design, folder: Path, *, console: Console | None = None) -> None:
    """Print what each record will do to the arm, how long to record and why, and the warnings.

    `folder`: Where it was written. `console`: The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    console.print(_table(design))
    for record in design.records:
        why = "; ".join(record.reasons)
        console.print(Text(f"{record.experiment.name}: {record.duration:.1f} s. {why}."))
    console.print(Text(f"log every {1e3 * clock_of(design.study.arm):g} ms or faster"))
    for line in _precision(design):
        console.print(Text(line))
    for warning in design.warnings:
        text = Text(f"warning [{warning.code}] {warning.where}: {warning.message}")
        console.print(text, style="yellow")
    for name in (*map(table_name, design.study.experiments), HEADER, "study.toml"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    logs = ", ".join(record.experiment.file for record in design.records)
    console.print(Text(f"still to be recorded, beside study.toml: {logs}"), soft_wrap=True)


def _precision(design: Design) -> Iterator[str]:
    """The sensors that are planned for, and the intervals they would give of gears and inertias."""
    own = [p for p in design.precision if p.name.startswith(_NAMES) and p.value and p.std]
    if not own:
        return
    yield (
        f"planned for {', '.join(_sensors(design.study))}; on the guessed arm their noise alone"
        " would leave these 95 % half-widths:"
    )
    for number in range(1, design.study.arm.n_joints + 1):
        parts = [
            f"{p.name} {196.0 * (p.std or 0.0) / abs(p.value or 1.0):.2g} %"
            for p in own
            if p.joint == number
        ]
        yield f"joint {number}: {', '.join(parts)}"


def _sensors(study: Study) -> Iterator[str]:
    """What each joint declares."""
    for number, joint in enumerate(study.arm.joints, start=1):
        named = [
            f"encoder of {joint.encoder_counts:g} counts" if joint.encoder_counts else "encoder"
        ]
        named += ["accelerometer"] if joint.accelerometer_distance else []
        named += ["gyro"] if joint.gyro_hz else []
        named += ["link encoder"] if f"theta_l{number}" in study.channels else []
        named += [] if len(named) > 1 else ["no link sensor"]
        yield f"joint {number}'s {' and '.join(named)}"


def _table(design: Design) -> Table:
    """A row a record and joint, with the limits at the end."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    table.add_column("predicted, SI units", no_wrap=True)
    for head in ("joint", "angle", "motor speed", "voltage", "gear torque", "standstill"):
        table.add_column(head, justify="right")
    rows = [cells for record in design.records for cells in _rows(record)]
    limits = design.limits
    for i in range(design.study.arm.n_joints):
        bounds = (limits.angle, limits.velocity, limits.voltage, limits.gear_torque)
        shown = (f"{bound[i]:.3g}" if np.isfinite(bound[i]) else "" for bound in bounds)
        rows.append(("limit", str(i + 1), *shown, ""))
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table


def _rows(record: Planned) -> list[tuple[str, ...]]:
    seen = record.predicted
    return [
        (
            record.experiment.name,
            str(i + 1),
            f"{seen.angle[i]:.3g}",
            f"{seen.velocity[i]:.3g}",
            f"{seen.voltage[i]:.3g}",
            f"{seen.gear_torque[i]:.3g}",
            f"{100.0 * seen.rest_share[i]:.0f} %",
        )
        for i in range(len(seen.angle))
    ]
