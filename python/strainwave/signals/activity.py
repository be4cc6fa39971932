"""Activity of each joint (RMS torque, velocity and acceleration) in the fitted records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Activity, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.channels import MotorInput
from strainwave.signals.drive_law import DriveLaw

# [s] of each velocity difference; reduces the effect of encoder quantization
_DIFFERENCE_TIME = 0.01


def activity_of(logs: Sequence[Log], arm: Arm) -> tuple[Activity, ...]:
    """Compute the RMS torque, velocity and acceleration of each joint over all fitted records.

    Velocities are differences over 0.01 s, which reduces the effect of encoder quantization.
    Validation records and records without the signals of the joint are excluded. Returns one entry
    per joint with signals in at least one record.
    """
    activities = []
    for number in range(1, arm.n_joints + 1):
        mean_squares = [
            mean_square
            for log in logs
            if log.experiment.use != "check"
            for mean_square in [_mean_squares(log, arm, number)]
            if mean_square is not None
        ]
        if mean_squares:
            torque, velocity, acceleration = np.sqrt(np.mean(mean_squares, axis=0)).tolist()
            activities.append(Activity(number, torque, velocity, acceleration))
    return tuple(activities)


def _mean_squares(log: Log, arm: Arm, number: int) -> FloatArray | None:
    """Mean squares of torque, velocity and acceleration of one joint; None without its signals."""
    angle = log.channels.get(f"theta_m{number}")
    motor = MotorInput.of(log, number, ("torque", "u"))
    step = max(1, round(_DIFFERENCE_TIME / log.sample_time))
    if motor is None or angle is None or len(angle) < 4 * step:
        return None
    span = step * log.sample_time
    velocity = (angle[step:] - angle[:-step]) / span
    acceleration = (velocity[step:] - velocity[:-step]) / span
    law = DriveLaw.of(arm.joints[number - 1])
    torque = law.command(motor.values) if motor.is_voltage else motor.values
    return np.array([np.mean(series**2) for series in (torque, velocity, acceleration)])
