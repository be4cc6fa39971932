"""Simulation of a planned drive on the guessed arm."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.domain.quantities import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory, simulate
from strainwave.experiment_design.plan import PredictedMotion, clock_of

_QUANTITIES: tuple[Quantity, ...] = (
    "link_angle",
    "motor_velocity",
    "voltage",
    "gear_torque",
    "sliding",
    "accelerometer",
)


def servo_drive(arm: Arm, values: Values, reference: FloatArray) -> Drive:
    """Drive of servos that follow references (n_ticks, n_joints), from rest at zero angles."""
    start = (0.0,) * arm.n_joints
    return Drive(
        tick=clock_of(arm),
        voltage=np.zeros_like(reference),
        reference=reference,
        servo=(True,) * arm.n_joints,
        motor_angle=start,
        initial_voltage=arm.holding_voltage(values, start),
    )


def run(arm: Arm, values: Values, drive: Drive) -> Trajectory:
    """Response of the guessed arm to a drive: limited quantities and accelerometers."""
    clock = clock_of(arm)
    samples = round(len(drive.voltage) * drive.tick / clock)
    return simulate(arm, values, drive, sample_time=clock, samples=samples, record=_QUANTITIES)


def predicted_motion(arm: Arm, values: Values, drive: Drive) -> PredictedMotion:
    """Peak values of the response to a drive, and the share of time in which each motor sticks."""
    trajectory = run(arm, values, drive)

    def peak(name: Quantity) -> FloatArray:
        return np.asarray(np.abs(trajectory[name]).max(axis=0))

    return PredictedMotion(
        angle=peak("link_angle"),
        velocity=peak("motor_velocity"),
        voltage=peak("voltage"),
        gear_torque=peak("gear_torque"),
        rest_share=np.asarray((trajectory["sliding"] == 0.0).mean(axis=0)),
    )
