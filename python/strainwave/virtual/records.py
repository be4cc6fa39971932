"""Sensor readings of a virtual arm in one experiment: its log by channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from strainwave.domain import FloatArray, Payload, Study
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import Axis, installed_axes
from strainwave.domain.link_sensors.imu import ImuAccelerometers, ImuGyros, ImuSensor
from strainwave.domain.quantities import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory, measure, record_inputs
from strainwave.errors import InvalidInput
from strainwave.virtual.plans import Plan


class Simulator(Protocol):
    """Engine of a virtual arm: `strainwave.dynamics.simulation.simulate` or another one."""

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        """Motion of the arm."""


def record_experiment(
    study: Study,
    arm: Arm,
    plan: Plan,
    values: Values,
    noise: SensorNoise | None,
    rng: np.random.Generator,
    simulator: Simulator,
    name: str = "",
    payload: Payload | None = None,
) -> dict[str, FloatArray]:
    """Simulate one experiment and return its log by channel.

    The channels of `study` state which links have encoders. `name` is that of the record, for
    record effects, `payload` the mass on the last link. Without `noise` the sensors are ideal.
    Raises InvalidInput if a parameter is missing or impossible, or if an IMU has no position and
    attitude.
    """
    axes = [
        axis for i in range(1, arm.n_joints + 1) for axis in installed_axes(arm, i, study.channels)
    ]
    _check_imus(study.path, axes)
    record: list[Quantity] = ["voltage", "encoder", "link_angle"]
    record += [name for axis in axes for name in axis.quantities]
    is_hanging = plan.drive.link_angle is None
    inputs = record_inputs(arm, values, name, hanging=is_hanging, payload=payload)
    trajectory = simulator(
        arm,
        inputs.values,
        inputs.shift_start(plan.drive),
        sample_time=plan.sample_time,
        samples=plan.samples,
        record=list(dict.fromkeys(record)),
    )
    measured = measure(trajectory, noise, rng)
    measured["encoder"] = inputs.read(measured["encoder"])
    measured["link_angle"] = inputs.read(measured["link_angle"], arm)
    columns = {"t": trajectory.time}
    for i, joint in enumerate(arm.joints):
        name = f"u{i + 1}" if joint.torque_per_volt else f"torque{i + 1}"
        columns[name] = measured["voltage"][:, i]
    for i in range(arm.n_joints):
        columns[f"theta_m{i + 1}"] = measured["encoder"][:, i]
    columns |= _readings([axis for axis in axes if not axis.is_mounted], measured)
    imu_axes = [axis for axis in axes if axis.is_mounted]
    columns |= _imu_readings(imu_axes, trajectory, noise, rng)
    if any(plan.drive.servo):
        tick = np.floor(trajectory.time / plan.drive.tick + 1e-9).astype(int)
        for i in range(arm.n_joints):
            columns[f"ref{i + 1}"] = plan.drive.reference[tick, i]
    return columns


def _check_imus(path: Path, axes: Sequence[Axis]) -> None:
    """Raise InvalidInput if an IMU has no position and attitude."""
    for axis in axes:
        sensor = axis.sensor
        if isinstance(sensor, ImuSensor) and (sensor.xyz is None or sensor.rpy is None):
            raise InvalidInput(
                f"the IMU on link {axis.joint} has no position and attitude for the simulation",
                where=str(path),
                remedy="set its xyz and rpy; identification does not need them",
            )


def _readings(
    axes: Sequence[Axis], measured: Mapping[Quantity, FloatArray]
) -> dict[str, FloatArray]:
    """Readings by channel, rounded to the counts of the sensors."""
    columns: dict[str, FloatArray] = {}
    for axis in axes:
        reading, count = axis.reading(measured, {}), axis.sensor.resolution
        columns[axis.channel] = count * np.round(reading / count) if count else reading
    return columns


def _imu_readings(
    axes: Sequence[Axis],
    trajectory: Trajectory,
    noise: SensorNoise | None,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """Readings of the axes of IMUs by channel. Gravity across the plane is part of the biases."""
    columns: dict[str, FloatArray] = {}
    kinds: tuple[tuple[type[ImuSensor], Quantity], ...] = (
        (ImuAccelerometers, "accelerometer"),
        (ImuGyros, "gyro"),
    )
    for kind, quantity in kinds:
        kind_axes = [axis for axis in axes if isinstance(axis.sensor, kind)]
        if not kind_axes:
            continue
        ideal = [axis.reading(trajectory.quantities, {}) for axis in kind_axes]
        readings = Trajectory(trajectory.time, {quantity: np.column_stack(ideal)})
        for axis, column in zip(kind_axes, measure(readings, noise, rng)[quantity].T, strict=True):
            columns[axis.channel] = column
    return columns
