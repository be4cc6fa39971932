"""What a planned experiment applies, as a table beside the study: apply-NAME.csv, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from strainwave.domain import ArmDescription, Experiment, FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput
from strainwave.io.logs.tables import open_table

_EVEN = 1e-3  # of a tick: how far from its place a row may lie


def table_name(experiment: Experiment) -> str:
    """The file of what is to be applied; the log that is recorded has the experiment's name."""
    return f"apply-{experiment.name}.csv"


def applied_columns(
    arm: ArmDescription, experiment: Experiment, drive: Drive, motor_angle: FloatArray | None
) -> dict[str, FloatArray]:
    """What is to be applied, a value a tick, with the unit in the name; zeros are left out.

    `motor_angle` (n_ticks, n_joints) [rad]: That is meant, for a drive that follows angles.
    """
    time: FloatArray = drive.tick * np.arange(len(drive.voltage), dtype=np.float64)
    columns = {"t [s]": time}
    for i, joint in enumerate(arm.joints):
        angle = "rad" if joint.motion == "revolute" else "m"
        number = i + 1
        if motor_angle is not None:
            columns[f"ref{number} [{angle}/s]"] = drive.reference[:, i]
            columns[f"theta_m{number} [{angle}]"] = motor_angle[:, i]
        elif experiment.joint == number:
            force = "N m" if joint.motion == "revolute" else "N"
            name = f"u{number} [V]" if joint.torque_per_volt else f"torque{number} [{force}]"
            columns[name] = drive.voltage[:, i]
    return columns


def read_applied(folder: Path, arm: Arm, experiment: Experiment, values: Values) -> Drive | None:
    """The drive of a planned experiment, if its table lies in a folder.

    `folder`: The study's. `values`: (name, joint) -> value of the arm, for what holds it at the
    start. Raises `InvalidInput`: The table is damaged, its clock is uneven, or it drives nothing of
    this arm.
    """
    path = folder / table_name(experiment)
    if not path.exists():
        return None
    table = open_table(path)
    read = table.read(table.names)
    columns = {name.partition(" ")[0]: column for name, column in read.items()}
    tick = _tick(columns.pop("t", np.zeros(0)), path)
    rows = len(next(iter(columns.values()), np.zeros(0)))
    voltage = np.zeros((rows, arm.n_joints))
    reference = np.zeros_like(voltage)
    start = np.zeros(arm.n_joints)
    for i in range(arm.n_joints):
        for name, into in ((f"u{i + 1}", voltage), (f"torque{i + 1}", voltage)):
            into[:, i] = columns.get(name, into[:, i])
        reference[:, i] = columns.get(f"ref{i + 1}", reference[:, i])
        start[i] = columns.get(f"theta_m{i + 1}", start[i : i + 1])[0]
    if not (voltage.any() or reference.any()):
        raise InvalidInput(
            f"applies nothing: {', '.join(read)}",
            where=str(path),
            remedy="give it a column u, torque or ref of a joint, or delete it",
        )
    angle = tuple(float(a) for a in start)
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
        places = time[0] + tick * np.arange(len(time))
        if tick > 0.0 and np.abs(time - places).max() <= _EVEN * tick:
            return float(f"{tick:.9g}")
    raise InvalidInput(
        "has no even column t [s] of two rows or more",
        where=str(path),
        remedy="design it anew with `strainwave excite`, or delete it",
    )
