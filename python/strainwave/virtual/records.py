"""Sensor readings of a virtual arm in one experiment: its log by channel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from strainwave.domain import FloatArray, Joint, Study
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import Axis, axes_of
from strainwave.domain.link_sensors.imu import ImuAccelerometers, ImuGyros, ImuSensor
from strainwave.domain.quantities import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.record_effects import record_inputs
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory, measure
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
) -> dict[str, FloatArray]:
    """Simulate one experiment and return its log by channel.

    The channels of `study` state which links have encoders. `name` is that of the record, for
    record effects. Without `noise` the sensors are ideal. Raises InvalidInput if a parameter is
    missing or impossible, or if an IMU has no position and attitude.
    """
    quantities: dict[str, Quantity] = {"theta_m": "encoder"}
    if any(joint.accelerometer_distance for joint in arm.joints):
        quantities["a"] = "accelerometer"
    if any(joint.gyro_hz for joint in arm.joints):
        quantities["gyro"] = "gyro"
    imu_axes = [axis for i in range(1, arm.n_joints + 1) for axis in _imu_axes(study.path, arm, i)]
    by_channel = [
        axis
        for i in range(1, arm.n_joints + 1)
        for axis in axes_of(arm, i)
        if axis.sensor.by_channel and axis.channel in study.channels
    ]
    record: list[Quantity] = ["voltage", "link_angle", *quantities.values()]
    record += [name for axis in (*imu_axes, *by_channel) for name in axis.quantities]
    inputs = record_inputs(arm, values, name, hanging=plan.drive.link_angle is None)
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
    measured["motor_angle"] = measured["encoder"]
    measured["link_angle"] = inputs.read(measured["link_angle"], arm.gear_ratios)
    columns = {"t": trajectory.time}
    for i, joint in enumerate(arm.joints):
        name = f"u{i + 1}" if joint.torque_per_volt else f"torque{i + 1}"
        columns[name] = measured["voltage"][:, i]
    for channel, quantity in quantities.items():
        for i, joint in enumerate(arm.joints):
            if _has_sensor(joint, quantity):
                columns[f"{channel}{i + 1}"] = measured[quantity][:, i]
    columns |= _imu_readings(imu_axes, trajectory, noise, rng)
    columns |= {axis.channel: axis.reading(measured, {}) for axis in by_channel}
    if any(plan.drive.servo):
        tick = np.floor(trajectory.time / plan.drive.tick + 1e-9).astype(int)
        for i in range(arm.n_joints):
            columns[f"ref{i + 1}"] = plan.drive.reference[tick, i]
    return columns


def _has_sensor(joint: Joint, quantity: Quantity) -> bool:
    """Whether a joint has the sensor that measures a quantity."""
    if quantity == "accelerometer":
        return joint.motion == "prismatic" or joint.accelerometer_distance is not None
    return quantity != "gyro" or joint.gyro_hz is not None


def _imu_axes(path: Path, arm: Arm, joint: int) -> list[Axis]:
    """All axes of a link's IMU."""
    imu = arm.joints[joint - 1].imu
    if imu is None:
        return []
    if imu.xyz is None or imu.rpy is None:
        raise InvalidInput(
            f"the IMU on link {joint} has no position and attitude for the simulation",
            where=str(path),
            remedy="set its xyz and rpy; identification does not need them",
        )
    return [axis for axis in axes_of(arm, joint) if isinstance(axis.sensor, ImuSensor)]


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
