"""Motions as trajectory_msgs/JointTrajectory, which ros2_control's controllers execute."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from strainwave.domain import Experiment
from strainwave.experiment_design.plan import Waypoints

_NANOSECONDS = 1_000_000_000
_DIGITS = 9  # significant digits of a number


def trajectory_name(experiment: Experiment) -> str:
    """File name of the trajectory of an experiment."""
    return f"trajectory-{experiment.name}.json"


def trajectory_text(joint_names: Sequence[str], waypoints: Waypoints) -> str:
    """The message as JSON, which is YAML as well, one point per line.

    Positions, velocities and accelerations are those of the links.
    """
    points = ",\n".join(
        f"    {json.dumps(_point(waypoints, k))}" for k in range(len(waypoints.time))
    )
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return (
        f'{{\n  "header": {json.dumps(header)},\n'
        f'  "joint_names": {json.dumps(list(joint_names))},\n'
        f'  "points": [\n{points}\n  ]\n}}\n'
    )


def _point(waypoints: Waypoints, row: int) -> dict[str, Any]:
    """One trajectory_msgs/JointTrajectoryPoint."""
    seconds, nanoseconds = divmod(round(waypoints.time[row] * _NANOSECONDS), _NANOSECONDS)
    values = {
        "positions": waypoints.angle,
        "velocities": waypoints.velocity,
        "accelerations": waypoints.acceleration,
    }
    point: dict[str, Any] = {
        name: [float(f"{value:.{_DIGITS}g}") for value in np.asarray(array[row]).tolist()]
        for name, array in values.items()
    }
    return point | {"time_from_start": {"sec": int(seconds), "nanosec": int(nanoseconds)}}
