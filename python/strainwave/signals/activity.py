"""Logs -> Activity: how hard each joint worked in the records that are fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Activity, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.signals.channels import torque_channel

_WINDOW = 0.01  # [s] over which velocities are averaged: well above an encoder's count


def activity_of(logs: Sequence[Log], arm: Arm) -> tuple[Activity, ...]:
    """Root mean squares of each joint's torque, velocity and acceleration over all fitted records.

    Velocities are differences over some hundredths of a second, so that counts of an encoder
    weigh little; records for checking are left out, and so are those that lack the joint's signals.

    Parameters
    ----------
    logs : sequence of Log
    arm : Arm

    Returns
    -------
    tuple of Activity
        One per joint that has signals in some record.
    """
    found = []
    for number in range(1, arm.n_joints + 1):
        parts = [
            part
            for log in logs
            if log.experiment.use != "check"
            for part in [_squares(log, arm, number)]
            if part is not None
        ]
        if parts:
            torque, velocity, acceleration = np.sqrt(np.mean(parts, axis=0)).tolist()
            found.append(Activity(number, torque, velocity, acceleration))
    return tuple(found)


def _squares(log: Log, arm: Arm, number: int) -> FloatArray | None:
    """Mean squares of torque, velocity and acceleration of one joint in one record."""
    angle = log.channels.get(f"theta_m{number}")
    try:
        name = torque_channel(log, number)
    except InvalidInput:
        return None
    step = max(1, round(_WINDOW / log.sample_time))
    if angle is None or len(angle) < 4 * step:
        return None
    joint = arm.joints[number - 1]
    scale = (joint.torque_per_volt or 1.0) if name.startswith("u") else 1.0
    span = step * log.sample_time
    velocity = (angle[step:] - angle[:-step]) / span
    acceleration = (velocity[step:] - velocity[:-step]) / span
    torque = scale * log.channels[name]
    return np.array([np.mean(series**2) for series in (torque, velocity, acceleration)])
