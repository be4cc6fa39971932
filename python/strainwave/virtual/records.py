"""What the sensors of a virtual arm write down in one run: its log by channel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from strainwave.domain import FloatArray, Joint, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import Axis, axes_of, factors
from strainwave.dynamics.record_effects import inputs_in
from strainwave.dynamics.simulation import Drive, Quantity, SensorNoise, Trajectory, measure
from strainwave.errors import InvalidInput
from strainwave.virtual.plans import Plan


class Simulator(Protocol):
    """What a virtual arm moves by: `strainwave.dynamics.simulation.simulate`, or another engine."""

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
        """What the arm did."""


def recorded(
    study: Study,
    arm: Arm,
    plan: Plan,
    values: Values,
    noise: SensorNoise | None,
    rng: np.random.Generator,
    simulator: Simulator,
    name: str = "",
) -> dict[str, FloatArray]:
    """Run one experiment; its log by channel.

    `study`: Its channels say which links have encoders. `values`: (name, joint) -> value. `noise`:
    None: ideal sensors. `rng`: Of the noise. `simulator`: What the arm moves by. `name`: Of the
    record, for what changes from one to the next. Raises `InvalidInput`: A parameter is missing or
    impossible, or an IMU has no place.
    """
    quantities: dict[str, Quantity] = {"theta_m": "encoder"}
    if any(joint.accelerometer_distance for joint in arm.joints):
        quantities["a"] = "accelerometer"
    if any(joint.gyro_hz for joint in arm.joints):
        quantities["gyro"] = "gyro"
    record: list[Quantity] = ["voltage", "link_angle", *quantities.values()]
    glued = [axis for i in range(1, arm.n_joints + 1) for axis in _glued(study.path, arm, i)]
    record += dict.fromkeys(name for axis in glued for name in axis.quantities)
    given = inputs_in(arm, values, name, hanging=plan.drive.link_angle is None)
    trajectory = simulator(
        arm,
        given.values,
        given.begun(plan.drive),
        sample_time=plan.sample_time,
        samples=plan.samples,
        record=record,
    )
    measured = measure(trajectory, noise, rng)
    measured["encoder"] = given.read(measured["encoder"])
    measured["link_angle"] = given.read(measured["link_angle"], arm.gear_ratios)
    columns = {"t": trajectory.time}
    for i, joint in enumerate(arm.joints):
        name = f"u{i + 1}" if joint.torque_per_volt else f"torque{i + 1}"
        columns[name] = measured["voltage"][:, i]
    for channel, quantity in quantities.items():
        for i, joint in enumerate(arm.joints):
            if _declares(joint, quantity):
                columns[f"{channel}{i + 1}"] = measured[quantity][:, i]
    columns |= _imus(arm, glued, trajectory, noise, rng)
    for i, joint in enumerate(arm.joints):
        link = measured["link_angle"][:, i]
        if f"theta_l{i + 1}" in study.channels:
            columns[f"theta_l{i + 1}"] = link
        if f"deflection{i + 1}" in study.channels:
            columns[f"deflection{i + 1}"] = link - joint.gear_ratio * measured["encoder"][:, i]
    if any(plan.drive.servo):
        at = np.floor(trajectory.time / plan.drive.tick + 1e-9).astype(int)
        for i in range(arm.n_joints):
            columns[f"ref{i + 1}"] = plan.drive.reference[at, i]
    return columns


def _declares(joint: Joint, quantity: Quantity) -> bool:
    """Whether a joint has the sensor that reads a quantity."""
    if quantity == "accelerometer":
        return joint.motion == "prismatic" or joint.accelerometer_distance is not None
    return quantity != "gyro" or joint.gyro_hz is not None


def _glued(path: Path, arm: Arm, joint: int) -> list[Axis]:
    """Every axis of a link's IMU."""
    imu = arm.joints[joint - 1].imu
    if imu is None:
        return []
    if imu.xyz is None or imu.rpy is None:
        raise InvalidInput(
            f"the IMU on link {joint} has no place to be simulated at",
            where=str(path),
            remedy="give its xyz and rpy; they may be left out again for identification",
        )
    kinds = ("ax", "ay", "az", "gx", "gy", "gz")
    return list(axes_of([f"{kind}{joint}" for kind in kinds], arm, joint))


def _imus(
    arm: Arm,
    axes: Sequence[Axis],
    trajectory: Trajectory,
    noise: SensorNoise | None,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """What the axes of IMUs write down, by channel; gravity across the plane is in their biases."""
    columns: dict[str, FloatArray] = {}
    kinds: tuple[tuple[str, Quantity], ...] = (("accelerometer", "accelerometer"), ("gyro", "gyro"))
    for kind, quantity in kinds:
        own = [axis for axis in axes if axis.kind == kind]
        if not own:
            continue
        ideal = [
            sum(
                count * trajectory[name][:, axis.joint - 1]
                for count, name in zip(factors(axis, arm, {}), axis.quantities, strict=True)
            )
            for axis in own
        ]
        readings = Trajectory(trajectory.time, {quantity: np.column_stack(ideal)})
        for axis, column in zip(own, measure(readings, noise, rng)[quantity].T, strict=True):
            columns[axis.channel] = column
    return columns
