"""Files of a design, next to its study: inputs, trajectories, a C header, predicted intervals.

apply-NAME.csv has the inputs of an experiment. trajectory-NAME.json is a
trajectory_msgs/JointTrajectory, which ros2_control's controllers execute. The terminal output of a
design is here as well.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from strainwave.domain import ArmDescription, Experiment, FloatArray
from strainwave.domain.arm.link_sensors import installed_axes
from strainwave.domain.keys import Values
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput
from strainwave.excite.guessed_arm import torque_errors_of
from strainwave.excite.plan import (
    LIMITED,
    Design,
    Limits,
    Motion,
    Planned,
    PredictedMotion,
    clock_of,
)
from strainwave.io.atomic_files import write_whole
from strainwave.io.base_parameters import base_parameter_list
from strainwave.io.logs.tables import open_table
from strainwave.io.results import estimates_document, to_json
from strainwave.io.study import copy_to, write_study
from strainwave.io.templates import fill_text
from strainwave.report.document.blocks import Row, Table, number, table
from strainwave.report.terminal import printed_table

HEADER_FILE = "excitation.h"
PRECISION_FILE = "predicted.json"

_MAX_CLOCK_JITTER = 1e-3  # in ticks
_NANOSECONDS = 1_000_000_000
_DIGITS = 9  # significant digits of a number
_NAMES = ("gear_stiffness", "gear_damping", "motor_inertia", "link_inertia")


def write(design: Design, folder: Path) -> None:
    """Write tables, trajectories, the header, predictions, and study.toml, whose logs are missing.

    Creates the folder. Raises InvalidInput if it cannot be written.
    """
    study = copy_to(design.study, folder)
    write_whole(folder, {name: text.encode() for name, text in _texts(design).items()})
    write_study(study, study.path)


def _texts(design: Design) -> dict[str, str]:
    arm, texts, records = design.study.arm, dict[str, str](), []
    for record in design.records:
        experiment, columns = record.experiment, applied_columns(design.study.arm, record)
        rows = map(_row, zip(*columns.values(), strict=True))
        texts[table_name(experiment)] = "\n".join([",".join(columns), *rows, ""])
        records.append((re.sub(r"\W", "_", experiment.name), record.drive, columns))
        if record.waypoints is not None:
            text = trajectory_text(arm.joint_names, record.waypoints)
            texts[trajectory_name(experiment)] = text
    header = fill_text(Path(__file__).with_name("excitation.h.j2"), records=records, row=_row)
    return texts | {HEADER_FILE: header, PRECISION_FILE: _predicted(design)}


def _predicted(design: Design) -> str:
    """Predicted parameters with intervals, in the layout of result.json."""
    rigid = design.records[0].precision
    final = {p.key: p for p in (*rigid, *design.precision)}  # the whole-arm fit comes last
    known = design.torque_errors
    errors = torque_errors_of(Arm.of(design.study.arm), known).tolist()
    document = {
        "torque_errors": [
            {"joint": i, "value": error, "source": "measured" if i in known else "assumed"}
            for i, error in enumerate(errors, start=1)
        ]
    }
    predicted = estimates_document(design.study.arm, final.values(), rigid)
    return to_json(document | predicted).decode()


def _row(values: Iterable[float]) -> str:
    return ",".join(f"{value:.9g}" for value in values)


def print_design(design: Design, folder: Path) -> None:
    """Print the total duration, the records with motion, duration and reasons, and the warnings.

    `folder` is where the design was written.
    """
    console = Console(highlight=False)
    shortage = f"; omitted for the duration: {', '.join(design.omitted)}" if design.omitted else ""
    total = f"{len(design.records)} records of {design.duration / 60.0:.1f} minutes together"
    console.print(Text(total + shortage, style="bold"))
    for predicted in _table(design):
        console.print(printed_table(predicted))
    for record in design.records:
        reasons = "; ".join(record.reasons)
        console.print(Text(f"{record.experiment.name}: {record.duration:.1f} s. {reasons}."))
    console.print(Text(f"log every {1e3 * clock_of(design.study.arm):g} ms or faster"))
    for line in _precision(design):
        console.print(Text(line))
    for warning in design.warnings:
        text = Text(f"warning [{warning.code}] {warning.where}: {warning.message}")
        console.print(text, style="yellow")
    trajectories = [trajectory_name(r.experiment) for r in design.records if r.waypoints]
    tables = map(table_name, design.study.experiments)
    for name in (*tables, *trajectories, HEADER_FILE, PRECISION_FILE, "study.toml"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    logs = ", ".join(record.experiment.file for record in design.records)
    console.print(Text(f"to be recorded, next to study.toml: {logs}"), soft_wrap=True)


def _precision(design: Design) -> Iterator[str]:
    """Planned sensors, and the predicted confidence intervals of gears and inertias."""
    yield from _base_precision(design)
    study, sensors, widths = design.study, list[str](), dict[int, list[str]]()
    for i, joint in enumerate(study.arm.joints, start=1):
        counts = joint.encoder_counts
        axes = installed_axes(study.arm, i, study.channels)
        nouns = dict.fromkeys(axis.sensor.noun for axis in axes) or ("no link sensor",)
        encoder = f"encoder of {counts:g} counts" if counts else "encoder"
        sensors.append(f"joint {i}'s {' and '.join((encoder, *nouns))}")
        widths[i] = [
            f"{p.name} {100.0 * CI95_STDS * p.std / abs(p.value):.2g} %"
            for p in design.precision
            if p.joint == i and p.name.startswith(_NAMES) and p.value and p.std
        ]
    if any(widths.values()):
        yield (
            f"sensors: {', '.join(sensors)}; predicted half-widths of the 95 % confidence "
            "intervals on the guessed arm:"
        )
        for i, texts in widths.items():
            yield f"joint {i}: {', '.join(texts)}"


def _base_precision(design: Design) -> Iterator[str]:
    """Largest predicted half-width of the base parameters of a chain, by unit."""
    base = base_parameter_list(design.study.arm, design.records[0].precision)
    if any(one.estimate.std is None for one in base):
        yield "the motion does not determine all base parameters"
    elif base:
        texts = []
        for unit in dict.fromkeys(one.estimate.unit for one in base):
            group = [one for one in base if one.estimate.unit == unit]
            widest = max(group, key=lambda one: one.estimate.std or 0.0)
            largest = max(abs(one.estimate.value or 0.0) for one in group)
            width = CI95_STDS * (widest.estimate.std or 0.0)
            share = f" ({100.0 * width / largest:.2g} % of the largest)" if largest else ""
            texts.append(f"{widest.name} {width:.2g} {unit}{share}")
        yield f"widest predicted half-widths of base parameters: {', '.join(texts)}"


def _table(design: Design) -> Iterator[Table]:
    """One row per record and joint, followed by the limits."""
    motions: list[tuple[str, PredictedMotion | Limits]]
    motions = [(record.experiment.name, record.predicted) for record in design.records]
    rows: list[Row] = []
    for name, row in (*motions, ("limit", design.limits)):
        for i in range(design.study.arm.n_joints):
            sizes = [getattr(row, key)[i] for key, *_ in LIMITED]
            texts = [f"{size:.3g}" if np.isfinite(size) else "" for size in sizes]
            rest = f"{100.0 * row.rest_share[i]:.0f} %" if isinstance(row, PredictedMotion) else ""
            rows.append((name, str(i + 1), *texts, rest))
    heads = ("joint", "angle", "motor speed", "voltage", "gear torque", "standstill")
    return table("Predicted motion", ("predicted, SI units", *map(number, heads)), rows)


def table_name(experiment: Experiment) -> str:
    """File name of the inputs of an experiment. The log has the experiment's own name."""
    return f"apply-{experiment.name}.csv"


def trajectory_name(experiment: Experiment) -> str:
    """File name of the trajectory of an experiment."""
    return f"trajectory-{experiment.name}.json"


def applied_columns(arm: ArmDescription, record: Planned) -> dict[str, FloatArray]:
    """Inputs of a record, one value per tick, with units in the column names.

    Inputs that are zero have no column. Drives that follow angles get the intended motion.
    """
    drive = record.drive
    time: FloatArray = drive.tick * np.arange(len(drive.voltage), dtype=np.float64)
    columns = {"t [s]": time}
    for i, joint in enumerate(arm.joints):
        angle = "rad" if joint.motion == "revolute" else "m"
        number = i + 1
        if record.motor_angle is not None:
            if arm.servo is not None:
                columns[f"ref{number} [{angle}/s]"] = drive.reference[:, i]
            columns[f"theta_m{number} [{angle}]"] = record.motor_angle[:, i]
        elif record.experiment.joint == number:
            force = "N m" if joint.motion == "revolute" else "N"
            name = f"u{number} [V]" if joint.torque_per_volt else f"torque{number} [{force}]"
            columns[name] = drive.voltage[:, i]
    return columns


def read_applied(folder: Path, arm: Arm, experiment: Experiment, values: Values) -> Drive | None:
    """Drive of a planned experiment from its table in the study's folder; None without a table.

    `values` give the voltage that holds the arm at the start. Raises InvalidInput if the table is
    damaged, if its clock is uneven, or if it has no input of this arm.
    """
    path = folder / table_name(experiment)
    if not path.exists():
        return None
    table = open_table(path)
    data = table.read(table.names)
    columns = {name.partition(" ")[0]: column for name, column in data.items()}
    tick = _tick(columns.pop("t", np.zeros(0)), path)
    rows = len(next(iter(columns.values()), np.zeros(0)))
    voltage = np.zeros((rows, arm.n_joints))
    reference = np.zeros_like(voltage)
    start = np.zeros(arm.n_joints)
    for i in range(arm.n_joints):
        for name in (f"u{i + 1}", f"torque{i + 1}"):
            voltage[:, i] = columns.get(name, voltage[:, i])
        reference[:, i] = columns.get(f"ref{i + 1}", reference[:, i])
        start[i] = columns.get(f"theta_m{i + 1}", start[i : i + 1])[0]
    if arm.servo is None and "servo" in experiment.control:
        raise InvalidInput(
            f"{experiment.name} follows angles by a controller that the study does not describe",
            where=str(path),
            remedy="to simulate it, add the [servo] to the study and run `strainwave excite` again",
        )
    if not (voltage.any() or reference.any()):
        raise InvalidInput(
            f"the table contains no non-zero input; its columns are {', '.join(data)}",
            where=str(path),
            remedy="add a column u, torque or ref of a joint, or delete the table",
        )
    angle = tuple(start.tolist())
    return Drive(
        tick=tick,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=angle,
        initial_voltage=arm.holding_voltage(values, angle),
    )


def _tick(time: FloatArray, path: Path) -> float:
    if len(time) > 1:
        tick = float((time[-1] - time[0]) / (len(time) - 1))
        uniform = time[0] + tick * np.arange(len(time))
        if tick > 0.0 and np.abs(time - uniform).max() <= _MAX_CLOCK_JITTER * tick:
            return float(f"{tick:.9g}")
    raise InvalidInput(
        "the table has no column t [s] of two or more equidistant rows",
        where=str(path),
        remedy="run `strainwave excite` again, or delete the table",
    )


def trajectory_text(joint_names: Sequence[str], waypoints: tuple[FloatArray, Motion]) -> str:
    """The message as JSON, which is YAML as well, one point per line.

    Positions, velocities and accelerations are those of the links.
    """
    times, motion = waypoints
    states = dict(zip(("positions", "velocities", "accelerations"), motion, strict=True))
    points = []
    for row, time in enumerate(times.tolist()):
        seconds, nanoseconds = divmod(round(time * _NANOSECONDS), _NANOSECONDS)
        point: dict[str, Any] = {
            name: [float(f"{value:.{_DIGITS}g}") for value in array[row].tolist()]
            for name, array in states.items()
        }
        point["time_from_start"] = {"sec": seconds, "nanosec": nanoseconds}
        points.append(f"    {json.dumps(point)}")
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return (
        f'{{\n  "header": {json.dumps(header)},\n'
        f'  "joint_names": {json.dumps(list(joint_names))},\n'
        '  "points": [\n' + ",\n".join(points) + "\n  ]\n}\n"
    )
