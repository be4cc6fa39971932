"""Terminal output of a design."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.domain import Study
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.link_sensors import installed_axes
from strainwave.experiment_design.command_table import table_name
from strainwave.experiment_design.plan import Design, Planned, clock_of
from strainwave.experiment_design.written import HEADER_FILE

_NAMES = ("gear_stiffness", "gear_damping", "motor_inertia", "link_inertia")


def print_design(design: Design, folder: Path) -> None:
    """Print the predicted motion, duration and reasons of each record, and the warnings.

    `folder` is where the design was written.
    """
    console = Console(highlight=False)
    console.print(_table(design))
    for record in design.records:
        reasons = "; ".join(record.reasons)
        console.print(Text(f"{record.experiment.name}: {record.duration:.1f} s. {reasons}."))
    console.print(Text(f"log every {1e3 * clock_of(design.study.arm):g} ms or faster"))
    for line in _precision(design):
        console.print(Text(line))
    for warning in design.warnings:
        text = Text(f"warning [{warning.code}] {warning.where}: {warning.message}")
        console.print(text, style="yellow")
    for name in (*map(table_name, design.study.experiments), HEADER_FILE, "study.toml"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    logs = ", ".join(record.experiment.file for record in design.records)
    console.print(Text(f"to be recorded, next to study.toml: {logs}"), soft_wrap=True)


def _precision(design: Design) -> Iterator[str]:
    """Planned sensors, and the predicted confidence intervals of gears and inertias."""
    parameters = [p for p in design.precision if p.name.startswith(_NAMES) and p.value and p.std]
    if not parameters:
        return
    yield (
        f"sensors: {', '.join(_sensors(design.study))}; predicted half-widths of the 95 %"
        " confidence intervals on the guessed arm:"
    )
    for number in range(1, design.study.arm.n_joints + 1):
        parts = [
            f"{p.name} {100.0 * CI95_STDS * (p.std or 0.0) / abs(p.value or 1.0):.2g} %"
            for p in parameters
            if p.joint == number
        ]
        yield f"joint {number}: {', '.join(parts)}"


def _sensors(study: Study) -> Iterator[str]:
    """Sensors of each joint."""
    for number, joint in enumerate(study.arm.joints, start=1):
        counts = joint.encoder_counts
        axes = installed_axes(study.arm, number, study.channels)
        nouns = dict.fromkeys(axis.sensor.noun for axis in axes) or ("no link sensor",)
        encoder = f"encoder of {counts:g} counts" if counts else "encoder"
        yield f"joint {number}'s {' and '.join((encoder, *nouns))}"


def _table(design: Design) -> Table:
    """One row per record and joint, followed by the limits."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    table.add_column("predicted, SI units", no_wrap=True)
    for head in ("joint", "angle", "motor speed", "voltage", "gear torque", "standstill"):
        table.add_column(head, justify="right")
    rows = [cells for record in design.records for cells in _rows(record)]
    limits = design.limits
    for i in range(design.study.arm.n_joints):
        bounds = (limits.angle, limits.velocity, limits.voltage, limits.gear_torque)
        texts = (f"{bound[i]:.3g}" if np.isfinite(bound[i]) else "" for bound in bounds)
        rows.append(("limit", str(i + 1), *texts, ""))
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table


def _rows(record: Planned) -> list[tuple[str, ...]]:
    motion = record.predicted
    return [
        (
            record.experiment.name,
            str(i + 1),
            f"{motion.angle[i]:.3g}",
            f"{motion.velocity[i]:.3g}",
            f"{motion.voltage[i]:.3g}",
            f"{motion.gear_torque[i]:.3g}",
            f"{100.0 * motion.rest_share[i]:.0f} %",
        )
        for i in range(len(motion.angle))
    ]
