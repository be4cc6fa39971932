"""Simulation of a planned drive on the guessed arm."""

from __future__ import annotations

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.domain.quantities import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory, simulate
from strainwave.experiment_design.plan import Limits, PredictedMotion, clock_of
from strainwave.experiment_design.self_distance import smallest_distance

_DISTANCE_INTERVAL = 0.01  # [s] between compared postures; links move by millimetres in it

_QUANTITIES: tuple[Quantity, ...] = (
    "link_angle",
    "motor_velocity",
    "voltage",
    "gear_torque",
    "sliding",
    "accelerometer",
)


def start_of(arm: Arm, limits: Limits) -> tuple[float, ...]:
    """Motor angles [rad] at which records begin: the posture in the middle of the limits."""
    return tuple(arm.motor_accelerations(limits.centre).tolist())


def servo_drive(arm: Arm, values: Values, limits: Limits, reference: FloatArray) -> Drive:
    """Drive of servos that follow references (n_ticks, n_joints), from rest."""
    start = start_of(arm, limits)
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


def followed_motion(
    arm: Arm, values: Values, motion: tuple[FloatArray, FloatArray, FloatArray], limits: Limits
) -> PredictedMotion:
    """Peak values of a motion of the links that a controller follows without error.

    `motion` has angles, velocities and accelerations (n_ticks, n_joints). The gears transmit what
    the motors give.
    """
    torque = arm.inverse_dynamics(arm.parameter_vector(values), *motion)
    ratios = np.abs([joint.gear_ratio for joint in arm.joints])
    compared = motion[0][:: max(1, int(_DISTANCE_INTERVAL / clock_of(arm)))]
    return PredictedMotion(
        angle=np.asarray(np.abs(motion[0] - limits.centre).max(axis=0)),
        velocity=np.asarray(np.abs(arm.motor_accelerations(motion[1])).max(axis=0)),
        voltage=np.asarray(np.abs(torque / arm.torque_per_volt).max(axis=0)),
        gear_torque=np.asarray(np.abs(torque / ratios).max(axis=0)),
        rest_share=np.zeros(arm.n_joints),
        distance=float(smallest_distance(arm, values, compared, limits.distance).min()),
    )


def predicted_motion(arm: Arm, values: Values, drive: Drive, limits: Limits) -> PredictedMotion:
    """Peak values of the guessed arm's response, and the share of time in which motors stick."""
    trajectory = run(arm, values, drive)

    def peak(name: Quantity) -> FloatArray:
        return np.asarray(np.abs(trajectory[name]).max(axis=0))

    angle = trajectory["link_angle"]
    compared = angle[:: max(1, int(_DISTANCE_INTERVAL / clock_of(arm)))]
    return PredictedMotion(
        angle=np.asarray(np.abs(angle - limits.centre).max(axis=0)),
        velocity=peak("motor_velocity"),
        voltage=peak("voltage"),
        gear_torque=peak("gear_torque"),
        rest_share=np.asarray((trajectory["sliding"] == 0.0).mean(axis=0)),
        distance=float(smallest_distance(arm, values, compared, limits.distance).min()),
    )
