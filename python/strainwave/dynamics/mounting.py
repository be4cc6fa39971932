"""Sensors glued anywhere on a link: what their axes read, and where they sit by what they read.

At (x, y) in the frame of its link, along the direction c in that plane, an accelerometer of a
planar arm reads

    c_x f_x + c_y f_y + (c_y x - c_x y) alpha - (c_x x + c_y y) w^2 + bias,

f the specific force at the link's own axis, alpha and w the link's angular acceleration and rate in
space. A gyro reads c_z w + bias. A link's frame has its origin on the link's own axis, x along the
link, and z along the axis.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Imu
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rotations import angles, attitude, rotation
from strainwave.dynamics.simulation import Quantity

Key = tuple[str, int | None]

BASIS: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration",
    "squared_rate",
)
"""What every accelerometer on a link reads a combination of."""

RATE: Quantity = "angular_rate"
"""What every gyro on it reads a share of."""

DISTANCE, TILT = "accelerometer_distance", "accelerometer_tilt"
PLACE = ("imu_x", "imu_y")
FROM_AXIS, BEARING = "imu_distance", "imu_bearing"
TURN = ("imu_turn_x", "imu_turn_y", "imu_turn_z")
START = ("imu_start_roll", "imu_start_pitch", "imu_start_yaw")
_LETTERS = "xyz"
_STEP = 1e-6  # by which slopes are taken; factors are products of few sines and numbers


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a sensor whose place is not taken for known."""

    channel: str
    joint: int  # from 1
    kind: str  # "tangential": a{i} without accelerometer_distance; "accelerometer", "gyro"
    number: int = 0  # of the IMU's axes, from 0

    @property
    def sensor(self) -> str:
        """The sensor that it is part of, as its constants are named."""
        return "accelerometer" if self.kind == "tangential" else f"imu_{self.kind}"

    @property
    def scaled(self) -> str:
        """By what its scale is named: each axis of an IMU has its own."""
        if self.kind == "tangential":
            return "accelerometer"
        return f"imu_{self.kind[0]}{_LETTERS[self.number]}"

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What it reads a combination of."""
        return (RATE,) if self.kind == "gyro" else BASIS


def axes_of(channels: Collection[str], arm: Arm, joint: int) -> tuple[Axis, ...]:
    """The axes on a link that need a mounting: all of its IMU, or `a{i}` of unknown distance.

    Beside an IMU such an `a{i}` is left out: it has little to add.

    `channels`: That were logged. `joint`: From 1.
    """
    own = arm.joints[joint - 1]
    if own.motion == "prismatic":
        return ()
    found = tuple(
        Axis(f"{kind[0]}{letter}{joint}", joint, kind, number)
        for kind in ("accelerometer", "gyro")
        for number, letter in enumerate(_LETTERS)
        if f"{kind[0]}{letter}{joint}" in channels
    )
    if found or own.accelerometer_distance is not None or f"a{joint}" not in channels:
        return found
    return (Axis(f"a{joint}", joint, "tangential"),)


def unknowns_of(axes: Sequence[Axis], arm: Arm) -> list[Key]:
    """What of the mounting of a link's axes is unknown, in the terms that a fit searches in.

    An attitude is a start, `START`, which stays, and a turn from there, which has no singular
    point. On the first link, whose axis stands still, the place is a distance from it and, under
    gravity, a bearing, and the attitude is relative to that: what records of short motions identify
    is apart from what they do not. One accelerometer alone lies in the plane of motion, and what
    gyros read of the rate is then unknown axis by axis.

    `axes`: Of one link.
    """
    if not axes:
        return []
    joint = axes[0].joint
    imu = arm.joints[joint - 1].imu or Imu()
    if axes[0].kind == "tangential":
        return [(DISTANCE, joint)]
    names: list[str] = []
    count = sum(axis.kind == "accelerometer" for axis in axes)
    if count and imu.xyz is None:
        polar = is_polar(arm, joint)
        names += (FROM_AXIS, *((BEARING,) if arm.gravity else ())) if polar else PLACE
    if count and imu.rpy is None:
        names += TURN if count > 1 else TURN[2:]
    if imu.rpy is None and count < 2:
        names += [_share(axis) for axis in axes if axis.kind == "gyro"]
    return [(name, joint) for name in names]


def is_polar(arm: Arm, joint: int) -> bool:
    """Whether the place of a link's IMU is unknown together with its attitude, on a fixed axis.

    `joint`: From 1.
    """
    imu = arm.joints[joint - 1].imu or Imu()
    return joint == 1 and imu.xyz is None and imu.rpy is None


def scale_is_apart(axis: Axis, axes: Sequence[Axis], arm: Arm) -> bool:
    """Whether an axis's scale is identifiable beside its mounting.

    `axes`: All of its sensor, itself among them.
    """
    imu = arm.joints[axis.joint - 1].imu or Imu()
    moves = axis.joint > 1 or bool(arm.gravity)
    count = sum(one.kind == "accelerometer" for one in axes)
    if axis.kind == "gyro":
        return imu.rpy is not None or count > 1
    return moves or count > 1 or (axis.kind == "accelerometer" and imu.xyz is not None)


def is_hidden(key: Key) -> bool:
    """Whether an unknown is a fit's own, of which place and attitude are made for the reader.

    `key` (name, joint).
    """
    name = key[0]
    return name in (BEARING, *TURN) or (name.startswith("imu_g") and name[-2:] == "_z")


def is_mounting(key: Key) -> bool:
    """Whether a parameter says where or how a sensor is mounted.

    `key` (name, joint).
    """
    return key[0] in (DISTANCE, TILT, FROM_AXIS, *PLACE) or is_hidden(key)


def factors(axis: Axis, arm: Arm, values: Mapping[Key, float]) -> FloatArray:
    """What each of an axis's `quantities` counts in its reading.

    `values`: Of the mounting's unknowns. Returns (n_quantities,).
    """
    joint = axis.joint
    imu = arm.joints[joint - 1].imu or Imu()
    if axis.kind == "tangential":
        tilt = values.get((TILT, joint), 0.0)
        return _at(-np.sin(tilt), np.cos(tilt), values[DISTANCE, joint], 0.0)
    if axis.kind == "gyro":
        share = values.get((_share(axis), joint))
        return np.array([_turned(arm, joint, values)[2, axis.number] if share is None else share])
    turned = _turned(arm, joint, values)[:2]
    along = turned[:, axis.number]
    if not is_polar(arm, joint):
        place = imu.xyz[:2] if imu.xyz is not None else [values[name, joint] for name in PLACE]
        return _at(along[0], along[1], place[0], place[1])
    bearing = values.get((BEARING, joint), 0.0)
    away, across = along.tolist()
    c = complex(away, across) * complex(np.cos(bearing), np.sin(bearing))
    distance = values[FROM_AXIS, joint]
    return np.array([c.real, c.imag, distance * across, -distance * away])


def _turned(arm: Arm, joint: int, values: Mapping[Key, float]) -> FloatArray:
    """The attitude of a link's IMU: (3, 3), its columns the sensor's axes in the link's frame."""
    imu = arm.joints[joint - 1].imu or Imu()
    return attitude_of(values, joint) if imu.rpy is None else attitude(imu.rpy)


def attitude_of(values: Mapping[Key, float], joint: int) -> FloatArray:
    """The attitude by a mounting's unknowns: that of the start, and a turn from there.

    `joint`: From 1. Returns (3, 3): Its columns are the sensor's axes in the link's frame.
    """
    turn = np.array([values.get((name, joint), 0.0) for name in TURN])
    start = attitude([values.get((name, joint), 0.0) for name in START])
    return np.asarray(start @ rotation(turn))


def slopes(axis: Axis, arm: Arm, values: Mapping[Key, float], keys: Sequence[Key]) -> FloatArray:
    """How an axis's factors depend on unknowns: (n_quantities, n_keys).

    Returns (n_quantities, n_keys).
    """
    found = np.zeros((len(axis.quantities), len(keys)))
    for k, key in enumerate(keys):
        if key[1] != axis.joint or not is_mounting(key):
            continue
        at = values.get(key, 0.0)
        ends = [factors(axis, arm, {**values, key: at + off}) for off in (_STEP, -_STEP)]
        found[:, k] = (ends[0] - ends[1]) / (2.0 * _STEP)
    return found


def with_places(arm: Arm, values: Mapping[Key, float]) -> Arm:
    """The arm with the distances of accelerometers that are among the values.

    Returns: With bandwidths that were found, too.
    """
    joints = []
    for i, joint in enumerate(arm.joints, start=1):
        hz = values.get(("accelerometer_bandwidth", i), np.inf)
        wide = joint.accelerometer_hz is None and np.isfinite(hz)
        joints.append(
            replace(
                joint,
                accelerometer_distance=joint.accelerometer_distance or values.get((DISTANCE, i)),
                accelerometer_hz=hz if wide else joint.accelerometer_hz,
            )
        )
    return arm.with_joints(joints)


def reported(
    axes: Sequence[Axis], arm: Arm, values: Mapping[Key, float]
) -> dict[str, tuple[float, str]]:
    """Place and attitude of a link's IMU for the reader, as far as they are made of unknowns.

    Roll and pitch need three accelerometers, or gyros beside two, which are alike in a mirror: of
    those the yaw is all that is reported, if the x axis is among them. On the first link without
    gravity it counts from the direction in which the sensor lies.

    `axes`: Of one link. `values`: Those of unknowns, held ones left out. Returns: name -> value and
    unit; what is an unknown of the fit already is not among them.
    """
    if not axes or (TURN[2], axes[0].joint) not in values:
        return {}
    joint = axes[0].joint
    found: dict[str, tuple[float, str]] = {}
    turned = _turned(arm, joint, values)
    if (BEARING, joint) in values:
        bearing, distance = values[BEARING, joint], values[FROM_AXIS, joint]
        found["imu_x"] = distance * float(np.cos(bearing)), "m"
        found["imu_y"] = distance * float(np.sin(bearing)), "m"
        turned = rotation(np.array([0.0, 0.0, bearing])) @ turned
    roll, pitch, yaw = angles(turned).tolist()
    accelerometers = {axis.number for axis in axes if axis.kind == "accelerometer"}
    gyros = any(axis.kind == "gyro" for axis in axes)
    if len(accelerometers) == 2 and not gyros and 0 not in accelerometers:
        return found
    if len(accelerometers) == 3 or (len(accelerometers) == 2 and gyros):
        found |= {"imu_roll": (roll, "rad"), "imu_pitch": (pitch, "rad")}
    found["imu_yaw"] = yaw, "rad"
    return found


def _share(axis: Axis) -> str:
    """The name of what a gyro's axis reads of the rate."""
    return f"{axis.scaled}_z"


def _at(c_x: float, c_y: float, x: float, y: float) -> FloatArray:
    return np.array([c_x, c_y, c_y * x - c_x * y, -(c_x * x + c_y * y)])
