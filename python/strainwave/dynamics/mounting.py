"""Mounting of link sensors: their readings, and the estimation of their position and attitude.

An accelerometer at (x, y) in the frame of its link, with direction c in that plane, reads on a
planar arm

    c_x f_x + c_y f_y + (c_y x - c_x y) alpha - (c_x x + c_y y) w^2 + bias

f is the specific force at the link's own axis, alpha and w are the absolute angular acceleration
and rate of the link. A gyro reads c_z w + bias. The frame of a link has its origin on the link's
own axis, x along the link, and z along the axis. Joints count from 1; keys are (name, joint).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Imu
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors.rotations import angles, attitude, rotation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Quantity

ACCELEROMETER_BASIS: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration",
    "squared_rate",
)
"""Quantities whose linear combination is the reading of an accelerometer on a link."""

GYRO_QUANTITY: Quantity = "angular_rate"
"""Quantity that a gyro on a link measures a share of."""

ACCELEROMETER_DISTANCE, ACCELEROMETER_TILT = "accelerometer_distance", "accelerometer_tilt"
IMU_POSITION = ("imu_x", "imu_y")
IMU_DISTANCE, IMU_BEARING = "imu_distance", "imu_bearing"
IMU_ROTATION = ("imu_turn_x", "imu_turn_y", "imu_turn_z")
IMU_START_ATTITUDE = ("imu_start_roll", "imu_start_pitch", "imu_start_yaw")
_LETTERS = "xyz"
_DIFFERENCE_STEP = 1e-6  # of central differences: factors are smooth, of the order of one


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a sensor whose mounting is not completely known."""

    channel: str
    joint: int  # from 1
    kind: str  # "tangential": a{i} without accelerometer_distance; "accelerometer", "gyro"
    number: int = 0  # index of the IMU's axis

    @property
    def sensor(self) -> str:
        """Name of the sensor in its constants."""
        return "accelerometer" if self.kind == "tangential" else f"imu_{self.kind}"

    @property
    def scaled(self) -> str:
        """Name of the scale: each axis of an IMU has its own."""
        if self.kind == "tangential":
            return "accelerometer"
        return f"imu_{self.kind[0]}{_LETTERS[self.number]}"

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities whose combination the axis reads."""
        return (GYRO_QUANTITY,) if self.kind == "gyro" else ACCELEROMETER_BASIS


def axes_of(channels: Collection[str], arm: Arm, joint: int) -> tuple[Axis, ...]:
    """Axes on a link that need a mounting: all axes of its IMU, or `a{i}` of unknown distance.

    If there is an IMU, such an `a{i}` is omitted because it adds little information.
    """
    description = arm.joints[joint - 1]
    if description.motion == "prismatic":
        return ()
    axes = tuple(
        Axis(f"{kind[0]}{letter}{joint}", joint, kind, number)
        for kind in ("accelerometer", "gyro")
        for number, letter in enumerate(_LETTERS)
        if f"{kind[0]}{letter}{joint}" in channels
    )
    if axes or description.accelerometer_distance is not None or f"a{joint}" not in channels:
        return axes
    return (Axis(f"a{joint}", joint, "tangential"),)


def unknowns_of(axes: Sequence[Axis], arm: Arm) -> list[Key]:
    """Unknowns of the mounting of one link's axes, in the coordinates of a fit.

    An attitude is a fixed start, `IMU_START_ATTITUDE`, and a rotation vector from there, which has
    no singular point. Axis 1 is fixed. On link 1 the position is therefore the distance from the
    axis and, under gravity, a bearing, and the attitude is relative to the bearing. These
    coordinates separate identifiable from unidentifiable quantities in short motions. A single
    accelerometer is assumed to lie in the plane of motion, and each gyro axis then has an unknown
    share of the rate.
    """
    if not axes:
        return []
    joint = axes[0].joint
    imu = arm.joints[joint - 1].imu or Imu()
    if axes[0].kind == "tangential":
        return [(ACCELEROMETER_DISTANCE, joint)]
    names: list[str] = []
    count = sum(axis.kind == "accelerometer" for axis in axes)
    if count and imu.xyz is None:
        polar = is_polar(arm, joint)
        names += (IMU_DISTANCE, *((IMU_BEARING,) if arm.gravity else ())) if polar else IMU_POSITION
    if count and imu.rpy is None:
        names += IMU_ROTATION if count > 1 else IMU_ROTATION[2:]
    if imu.rpy is None and count < 2:
        names += [_share(axis) for axis in axes if axis.kind == "gyro"]
    return [(name, joint) for name in names]


def is_polar(arm: Arm, joint: int) -> bool:
    """Whether position and attitude of a link's IMU are both unknown and its axis is fixed."""
    imu = arm.joints[joint - 1].imu or Imu()
    return joint == 1 and imu.xyz is None and imu.rpy is None


def is_scale_identifiable(axis: Axis, axes: Sequence[Axis], arm: Arm) -> bool:
    """Whether the scale of an axis is identifiable in addition to its mounting.

    `axes` are all axes of the sensor.
    """
    imu = arm.joints[axis.joint - 1].imu or Imu()
    has_varying_force = axis.joint > 1 or bool(arm.gravity)
    count = sum(other.kind == "accelerometer" for other in axes)
    if axis.kind == "gyro":
        return imu.rpy is not None or count > 1
    return has_varying_force or count > 1 or (axis.kind == "accelerometer" and imu.xyz is not None)


def is_hidden(key: Key) -> bool:
    """Whether an unknown is internal to the fit; results report position and attitude instead."""
    name = key[0]
    return name in (IMU_BEARING, *IMU_ROTATION) or (name.startswith("imu_g") and name[-2:] == "_z")


def is_mounting(key: Key) -> bool:
    """Whether a parameter is a position or an attitude of a sensor."""
    return key[0] in (
        ACCELEROMETER_DISTANCE,
        ACCELEROMETER_TILT,
        IMU_DISTANCE,
        *IMU_POSITION,
    ) or is_hidden(key)


def factors(axis: Axis, arm: Arm, values: Mapping[Key, float]) -> FloatArray:
    """Weights (n_quantities,) of an axis's `quantities` for values of the mounting's unknowns."""
    joint = axis.joint
    imu = arm.joints[joint - 1].imu or Imu()
    if axis.kind == "tangential":
        tilt = values.get((ACCELEROMETER_TILT, joint), 0.0)
        return _accelerometer_factors(
            -np.sin(tilt), np.cos(tilt), values[ACCELEROMETER_DISTANCE, joint], 0.0
        )
    if axis.kind == "gyro":
        share = values.get((_share(axis), joint))
        if share is None:
            share = _attitude(arm, joint, values)[2, axis.number]
        return np.array([share])
    direction = _attitude(arm, joint, values)[:2, axis.number]
    if not is_polar(arm, joint):
        position = (
            imu.xyz[:2] if imu.xyz is not None else [values[name, joint] for name in IMU_POSITION]
        )
        return _accelerometer_factors(direction[0], direction[1], position[0], position[1])
    bearing = values.get((IMU_BEARING, joint), 0.0)
    radial, tangential = direction.tolist()
    c = complex(radial, tangential) * complex(np.cos(bearing), np.sin(bearing))
    distance = values[IMU_DISTANCE, joint]
    return np.array([c.real, c.imag, distance * tangential, -distance * radial])


def _attitude(arm: Arm, joint: int, values: Mapping[Key, float]) -> FloatArray:
    """Attitude (3, 3) of a link's IMU; its columns are the sensor's axes in the link's frame."""
    imu = arm.joints[joint - 1].imu or Imu()
    return attitude_of(values, joint) if imu.rpy is None else attitude(imu.rpy)


def attitude_of(values: Mapping[Key, float], joint: int) -> FloatArray:
    """Attitude (3, 3) from a mounting's unknowns: the start, followed by the rotation vector.

    Its columns are the sensor's axes in the link's frame.
    """
    turn = np.array([values.get((name, joint), 0.0) for name in IMU_ROTATION])
    start = attitude([values.get((name, joint), 0.0) for name in IMU_START_ATTITUDE])
    return np.asarray(start @ rotation(turn))


def slopes(axis: Axis, arm: Arm, values: Mapping[Key, float], keys: Sequence[Key]) -> FloatArray:
    """Derivatives of an axis's factors with respect to unknowns: (n_quantities, n_keys)."""
    derivatives = np.zeros((len(axis.quantities), len(keys)))
    for k, key in enumerate(keys):
        if key[1] != axis.joint or not is_mounting(key):
            continue
        value, step = values.get(key, 0.0), _DIFFERENCE_STEP
        high, low = (factors(axis, arm, {**values, key: value + s}) for s in (step, -step))
        derivatives[:, k] = (high - low) / (2.0 * step)
    return derivatives


def with_sensor_positions(arm: Arm, values: Mapping[Key, float]) -> Arm:
    """The arm with the estimated distances and bandwidths of accelerometers."""
    joints = []
    for i, joint in enumerate(arm.joints, start=1):
        hz = values.get(("accelerometer_bandwidth", i), np.inf)
        is_estimated = joint.accelerometer_hz is None and np.isfinite(hz)
        joints.append(
            replace(
                joint,
                accelerometer_distance=joint.accelerometer_distance
                or values.get((ACCELEROMETER_DISTANCE, i)),
                accelerometer_hz=hz if is_estimated else joint.accelerometer_hz,
            )
        )
    return arm.with_joints(joints)


def reported(
    axes: Sequence[Axis], arm: Arm, values: Mapping[Key, float]
) -> dict[str, tuple[float, str]]:
    """Position and attitude of a link's IMU as far as they follow from unknowns: value and unit.

    Roll and pitch need three accelerometers, or two and gyros. Two accelerometers without gyros do
    not distinguish mirror images, so only the yaw is reported, and only if the x axis is one of
    them. On link 1 without gravity the yaw counts from the direction of the sensor's position.
    Unknowns of the fit are not in the result.
    """
    if not axes or (IMU_ROTATION[2], axes[0].joint) not in values:
        return {}
    joint = axes[0].joint
    report: dict[str, tuple[float, str]] = {}
    matrix = _attitude(arm, joint, values)
    if (IMU_BEARING, joint) in values:
        bearing, distance = values[IMU_BEARING, joint], values[IMU_DISTANCE, joint]
        report["imu_x"] = distance * float(np.cos(bearing)), "m"
        report["imu_y"] = distance * float(np.sin(bearing)), "m"
        matrix = rotation(np.array([0.0, 0.0, bearing])) @ matrix
    roll, pitch, yaw = angles(matrix).tolist()
    accelerometers = {axis.number for axis in axes if axis.kind == "accelerometer"}
    gyros = any(axis.kind == "gyro" for axis in axes)
    if len(accelerometers) == 2 and not gyros and 0 not in accelerometers:
        return report
    if len(accelerometers) == 3 or (len(accelerometers) == 2 and gyros):
        report |= {"imu_roll": (roll, "rad"), "imu_pitch": (pitch, "rad")}
    report["imu_yaw"] = yaw, "rad"
    return report


def _share(axis: Axis) -> str:
    """Name of a gyro axis's share of the rate."""
    return f"{axis.scaled}_z"


def _accelerometer_factors(c_x: float, c_y: float, x: float, y: float) -> FloatArray:
    return np.array([c_x, c_y, c_y * x - c_x * y, -(c_x * x + c_y * y)])
