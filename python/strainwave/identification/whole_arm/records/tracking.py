"""Weak feedback that keeps the simulated motors near their measured angles.

Under gravity an upright link falls, and the error of a simulation by recorded voltages alone grows
several times in a second. A feedback faster than the fall, and slower than the resonances of the
gears, bounds it. Errors of the model still show in the velocities, damped below its bandwidth; the
rounding of the encoder enters far below the noise of the channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import ControlLaw, FloatArray, JointModel, LinearServo
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive

BANDWIDTH = 10.0
"""Natural frequency [rad/s] of a motor under the feedback; errors of a falling arm grow at 4 to 7
per second."""
_DAMPING_RATIO = 0.7
_LAG = 0.02  # [s] time constant of the feedback's derivative
_NO_LIMIT = 1e9  # [V]


def tracked_inertias(joints: Sequence[JointModel], arm: Arm) -> FloatArray | None:
    """Inertia at each motor over its torque per volt, (n_joints,) [V s^2/rad].

    Of several models of a joint the first counts. None without gravity, or if a joint has no
    plausible inertia: recorded voltages alone then drive the arm.
    """
    inertias: Mapping[int, float] = {
        model.joint: model.values["motor_inertia"]
        + arm.gear_ratios[model.joint - 1] ** 2 * model.values["link_inertia"]
        for model in reversed(joints)
    }
    if not arm.gravity_size or set(inertias) != set(range(1, arm.n_joints + 1)):
        return None
    each = np.array([inertias[i] for i in range(1, arm.n_joints + 1)]) / arm.torque_per_volt
    return each if np.all(each > 0.0) else None


def track(drive: Drive, angle: FloatArray, inertia: FloatArray) -> Drive:
    """Drive whose voltages pull the motors to measured angles (n_ticks, n_joints) [rad].

    `inertia` (n_joints,) [V s^2/rad] is that of `tracked_inertias`. A motor of this inertia follows
    with `BANDWIDTH`.
    """
    decay = float(np.exp(-drive.tick / _LAG))
    laws = []
    for one in inertia.tolist():
        stiffness, damping = one * BANDWIDTH**2, 2.0 * _DAMPING_RATIO * BANDWIDTH * one
        # the state is the error behind a low-pass, the derivative the difference from it
        laws.append(
            ControlLaw(
                A=np.array([[decay]]),
                B=(1.0 - decay) * np.array([[1.0, 0.0, -1.0]]),
                C=np.array([-damping / _LAG]),
                D=(stiffness + damping / _LAG) * np.array([1.0, 0.0, -1.0]),
                E=np.zeros(1),
                holds=np.zeros(1, dtype=bool),
            )
        )
    return replace(
        drive,
        reference=np.diff(angle, axis=0, append=angle[-1:]) / drive.tick,
        servo=(True,) * len(laws),
        linear_servo=LinearServo(tuple(laws), period=drive.tick, limit=_NO_LIMIT),
    )
