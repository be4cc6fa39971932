"""Inputs of a planned experiment, next to the study: apply-NAME.csv, trajectory-NAME.json.

The latter is a trajectory_msgs/JointTrajectory, which ros2_control's controllers execute.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import ArmDescription, Experiment, FloatArray
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput
from strainwave.excite.plan import Planned, Waypoints
from strainwave.io.logs.tables import open_table

_MAX_CLOCK_JITTER = 1e-3  # in ticks
_NANOSECONDS = 1_000_000_000
_DIGITS = 9  # significant digits of a number


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


def trajectory_text(joint_names: Sequence[str], waypoints: Waypoints) -> str:
    """The message as JSON, which is YAML as well, one point per line.

    Positions, velocities and accelerations are those of the links.
    """
    states = {
        "positions": waypoints.angle,
        "velocities": waypoints.velocity,
        "accelerations": waypoints.acceleration,
    }
    points = []
    for row, time in enumerate(waypoints.time.tolist()):
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
