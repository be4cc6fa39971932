"""A planned drive on the guessed arm: how far, how fast, how hard, and whether it ever rests."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, Trajectory, simulate
from strainwave.experiment_design.plan import PredictedMotion

_QUANTITIES: tuple[Quantity, ...] = (
    "link_angle",
    "motor_velocity",
    "voltage",
    "gear_torque",
    "sliding",
    "accelerometer",
)


def run(arm: Arm, values: Values, drive: Drive, sample_time: float) -> Trajectory:
    """The guessed arm's answer to a drive.

    `values`: (name, joint) -> value. `sample_time` [s]. Returns: With all that `predicted_motion`
    looks at, and the accelerometers.
    """
    samples = round(len(drive.voltage) * drive.tick / sample_time)
    return simulate(
        arm, values, drive, sample_time=sample_time, samples=samples, record=_QUANTITIES
    )


def predicted_motion(trajectory: Trajectory) -> PredictedMotion:
    """The largest magnitudes of a run, and the part of it in which each motor stands."""

    def peak(name: Quantity) -> FloatArray:
        return np.asarray(np.abs(trajectory[name]).max(axis=0))

    return PredictedMotion(
        angle=peak("link_angle"),
        velocity=peak("motor_velocity"),
        voltage=peak("voltage"),
        gear_torque=peak("gear_torque"),
        rest_share=np.asarray((trajectory["sliding"] == 0.0).mean(axis=0)),
    )
