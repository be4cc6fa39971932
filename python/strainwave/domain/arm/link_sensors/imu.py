"""IMU: accelerometers and gyros in one case at any position and attitude on a link.

An unknown mounting is a position and a rotation from a starting attitude, of which the space of the
link (`LinkSpace`) frees what its readings show. A link that turns about one direction has two
coordinates across it; a single accelerometer is then assumed to lie in the plane of motion, and
each gyro axis has an unknown share of the rate. If that axis is fixed, the position is a distance
from the axis and, where the specific force varies, a bearing, and the attitude is relative to the
bearing. These coordinates separate identifiable from unidentifiable quantities in short motions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from strainwave.domain.arm.description import Imu, Joint
from strainwave.domain.arm.link_sensors.interface import (
    ConstantKind,
    LinkSensor,
    SensorAxis,
    SensorConstant,
    SensorGroup,
)
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    GYRO_QUANTITIES,
    LinkSpace,
    Quantity,
    accelerometer_weights,
    angles,
    attitude,
    rotation,
)
from strainwave.domain.keys import FloatArray, Key

IMU_POSITION = ("imu_x", "imu_y", "imu_z")
IMU_ATTITUDE = ("imu_roll", "imu_pitch", "imu_yaw")
IMU_DISTANCE, IMU_BEARING = "imu_distance", "imu_bearing"
IMU_ROTATION = ("imu_turn_x", "imu_turn_y", "imu_turn_z")
"""Rotation vector from the starting attitude, without singular point."""
IMU_START_ATTITUDE = ("imu_start_roll", "imu_start_pitch", "imu_start_yaw")
"""Starting attitude, fixed in a fit."""

_MIN_RATE_SHARE = 1e-3  # of a gyro axis in the rate of its link; less is a mounting error

_K = ConstantKind
_IN_FRAME = "of the IMU in its link's frame, as in URDF"
_MOUNTING_CONSTANTS = (
    SensorConstant("imu", _K.POSITION_X, "m", f"x coordinate {_IN_FRAME}", "x"),
    SensorConstant("imu", _K.POSITION_Y, "m", f"y coordinate {_IN_FRAME}", "y"),
    SensorConstant("imu", _K.POSITION_Z, "m", f"z coordinate {_IN_FRAME}", "z"),
    SensorConstant("imu", _K.DISTANCE, "m", "distance of the IMU from its link's own axis"),
    SensorConstant("imu", _K.ROLL, "rad", f"roll {_IN_FRAME}"),
    SensorConstant("imu", _K.PITCH, "rad", f"pitch {_IN_FRAME}"),
    SensorConstant("imu", _K.YAW, "rad", f"yaw {_IN_FRAME}"),
    SensorConstant("imu", _K.BEARING, "1"),
    *(SensorConstant("imu", kind, "1") for kind in (_K.ROTATION_X, _K.ROTATION_Y, _K.ROTATION_Z)),
    *(SensorConstant("imu", kind, "rad") for kind in (_K.START_ROLL, _K.START_PITCH, _K.START_YAW)),
)


@dataclass(frozen=True)
class ImuSensor(LinkSensor):
    """Accelerometers or gyros of an IMU, with three axes."""

    case: Imu | None = None  # None: the joint's table has none, and nothing is known

    keys: ClassVar[Mapping[str, tuple[str, str]]] = {"imu": ("IMU", "")}
    axis_name: ClassVar[str]
    case_key: ClassVar[str]  # of the bandwidth [Hz] in the table of the IMU
    symbols = False
    group = SensorGroup.MOUNTED

    @classmethod
    def of_joint(cls, joint: Joint) -> Self | None:
        return cls(joint.imu) if joint.imu or joint.motion == "revolute" else None

    @property
    def hz(self) -> float | None:
        return None if self.case is None else getattr(self.case, self.case_key)

    @property
    def is_in_table(self) -> bool:
        return self.case is not None

    def with_bandwidth(self, joint: Joint, hz: float) -> Joint:
        changes: dict[str, Any] = {self.case_key: hz}
        return replace(joint, imu=joint.imu and replace(joint.imu, **changes))

    def low_passes(self) -> Mapping[str, float | None]:
        return {} if self.case is None else {f"imu_{self.case_key}": self.hz}

    @property
    def xyz(self) -> Sequence[float] | None:
        """Position [m]; None: estimated."""
        return None if self.case is None else self.case.xyz

    @property
    def rpy(self) -> Sequence[float] | None:
        """Attitude [rad]; None: estimated."""
        return None if self.case is None else self.case.rpy

    @classmethod
    def owner(cls, number: int) -> str:
        return f"imu_{cls.channel_kinds[number]}"

    @classmethod
    def axis_noun(cls, number: int) -> str:
        return f"IMU's {'xyz'[number]} {cls.axis_name}"

    def attitude(self, joint: int, values: Mapping[Key, float]) -> FloatArray:
        """Attitude (3, 3); its columns are the sensor's axes in the link's frame."""
        return attitude_of(values, joint) if self.rpy is None else attitude(self.rpy)

    def pose(
        self, axis: SensorAxis, values: Mapping[Key, float]
    ) -> tuple[FloatArray, Sequence[float]]:
        """Attitude (3, 3) and position (3,) [m] in the link's frame, turned by the bearing."""
        joint, matrix = axis.joint, self.attitude(axis.joint, values)
        if self.xyz is not None:
            return matrix, self.xyz
        if not self._is_polar(axis.space):
            free = axis.space.free_coordinates
            return matrix, [values[IMU_POSITION[k], joint] if k in free else 0.0 for k in range(3)]
        bearing, distance = values.get((IMU_BEARING, joint), 0.0), values[IMU_DISTANCE, joint]
        x, y, z = axis.space.directions
        position = distance * (math.cos(bearing) * x + math.sin(bearing) * y)
        return rotation(bearing * z) @ matrix, position.tolist()

    def unknowns(self, axes: Sequence[SensorAxis]) -> list[Key]:
        joint, space, count = axes[0].joint, axes[0].space, _count_accelerometers(axes)
        names: list[str] = []
        if count and self.xyz is None:
            bearing = (IMU_BEARING,) if space.has_varying_force else ()
            coordinates = [IMU_POSITION[k] for k in space.free_coordinates]
            names += (IMU_DISTANCE, *bearing) if self._is_polar(space) else coordinates
        if self.rpy is None:
            names += self._turns(axes)
        shares = (axis.key(ConstantKind.SHARE) for axis in axes)
        keys: list[Key] = [(name, joint) for name in names]
        return [*keys, *(key for key in shares if key and self._has_shares(axes))]

    def _turns(self, axes: Sequence[SensorAxis]) -> Sequence[str]:
        """Rotations that change the readings: all, or not that about the only axis."""
        numbers, count = {axis.number for axis in axes}, _count_accelerometers(axes)
        if axes[0].space.axis is None:
            return [name for k, name in enumerate(IMU_ROTATION) if numbers != {k}]
        return IMU_ROTATION if count > 1 else IMU_ROTATION[2:] if count else ()

    def _has_shares(self, axes: Sequence[SensorAxis]) -> bool:
        """Whether too few axes show the attitude, so that gyros have shares of the only rate."""
        has_one_rate = axes[0].space.axis is not None
        return has_one_rate and self.rpy is None and _count_accelerometers(axes) < 2

    def report(
        self, axes: Sequence[SensorAxis], values: Mapping[Key, float]
    ) -> dict[str, tuple[float, str]]:
        """Position and attitude as far as they follow from unknowns that are not in results.

        About one axis, roll and pitch need three accelerometers, or two and gyros. Two
        accelerometers without gyros do not distinguish mirror images, so only the yaw is reported,
        and only if the x axis is one of them. On a link about a fixed axis without gravity the yaw
        counts from the direction of the position. About several axes, any two sensor axes show the
        attitude.
        """
        joint, space = axes[0].joint, axes[0].space
        if (IMU_ROTATION[2], joint) not in values:
            return {}
        report: dict[str, tuple[float, str]] = {}
        matrix = self.attitude(joint, values)
        if (IMU_BEARING, joint) in values:
            matrix, position = self.pose(axes[0], values)
            names = (IMU_POSITION[k] for k in space.free_coordinates)
            coordinates = space.coordinates(np.array(position))
            report |= {name: (x, "m") for name, x in zip(names, coordinates, strict=True)}
        roll, pitch, yaw = angles(matrix).tolist()
        if space.axis is None:
            rpy = {"imu_roll": (roll, "rad"), "imu_pitch": (pitch, "rad"), "imu_yaw": (yaw, "rad")}
            return rpy if len({axis.number for axis in axes}) > 1 else {}
        count = _count_accelerometers(axes)
        has_gyros = count < len(axes)
        if count == 2 and not has_gyros and all(axis.number for axis in axes):
            return report
        if count == 3 or (count == 2 and has_gyros):
            report |= {"imu_roll": (roll, "rad"), "imu_pitch": (pitch, "rad")}
        return report | {"imu_yaw": (yaw, "rad")}

    def _is_polar(self, space: LinkSpace) -> bool:
        """Whether position and attitude are both unknown and the link's axis is fixed."""
        return space.is_axis_fixed and self.xyz is None and self.rpy is None


@dataclass(frozen=True)
class ImuAccelerometers(ImuSensor):
    """Accelerometers `ax{i}`, `ay{i}`, `az{i}` of an IMU."""

    name = "imu_accelerometer"
    noun = "IMU's accelerometers"
    axis_name = "accelerometer"
    case_key = "accelerometer_hz"
    channel_kinds = ("ax", "ay", "az")
    unit = "m/s^2"
    measurand = "specific force"

    def quantities(self) -> tuple[Quantity, ...]:
        return ACCELEROMETER_QUANTITIES

    def weights(self, axis: SensorAxis, values: Mapping[Key, float]) -> FloatArray:
        matrix, position = self.pose(axis, values)
        return accelerometer_weights(matrix[:, axis.number].tolist(), position)

    def is_scale_identifiable(self, axis: SensorAxis, axes: Sequence[SensorAxis]) -> bool:
        has_varying_force = axis.space.has_varying_force
        return has_varying_force or _count_accelerometers(axes) > 1 or self.xyz is not None

    @classmethod
    def extra_constants(cls) -> tuple[SensorConstant, ...]:
        return _MOUNTING_CONSTANTS


@dataclass(frozen=True)
class ImuGyros(ImuSensor):
    """Gyros `gx{i}`, `gy{i}`, `gz{i}` of an IMU."""

    name = "imu_gyro"
    noun = "IMU's gyros"
    axis_name = "gyro"
    case_key = "gyro_hz"
    channel_kinds = ("gx", "gy", "gz")
    unit = "rad/s"
    measurand = "angular rate"

    def quantities(self) -> tuple[Quantity, ...]:
        return GYRO_QUANTITIES

    def weights(self, axis: SensorAxis, values: Mapping[Key, float]) -> FloatArray:
        share = values.get(axis.key(ConstantKind.SHARE) or ("", None))
        if share is None:
            return self.attitude(axis.joint, values)[:, axis.number]
        return np.asarray(share * axis.space.directions[2])

    def is_scale_identifiable(self, axis: SensorAxis, axes: Sequence[SensorAxis]) -> bool:
        """Whether the rate along the axis varies: not across the only axis of the link."""
        if axis.space.axis is not None and self.rpy is not None:
            along = attitude(self.rpy)[:, axis.number] @ axis.space.directions[2]
            return abs(float(along)) > _MIN_RATE_SHARE
        return not self._has_shares(axes)

    @classmethod
    def extra_constants(cls) -> tuple[SensorConstant, ...]:
        """Share of each axis in the link's rate."""
        numbers = range(len(cls.channel_kinds))
        return tuple(SensorConstant(cls.owner(k), ConstantKind.SHARE, "1") for k in numbers)


def attitude_of(values: Mapping[Key, float], joint: int) -> FloatArray:
    """Attitude (3, 3) from a mounting's unknowns: the start, followed by the rotation vector.

    Its columns are the sensor's axes in the link's frame.
    """
    turn = np.array([values.get((name, joint), 0.0) for name in IMU_ROTATION])
    start = attitude([values.get((name, joint), 0.0) for name in IMU_START_ATTITUDE])
    return np.asarray(start @ rotation(turn))


def _count_accelerometers(axes: Sequence[SensorAxis]) -> int:
    return sum(isinstance(axis.sensor, ImuAccelerometers) for axis in axes)
