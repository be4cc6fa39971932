"""What was measured, on what arm, and how; `strainwave.io.study` checks the `annotated_types`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, MinLen

from strainwave.domain.options import Options

Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]

ArmKind = Literal["planar-two-link", "single-joint"]
Motion = Literal["revolute", "prismatic"]
Spring = Literal["linear", "three-slope", "rigid"]
Effect = Literal["stribeck", "hysteresis", "kinematic-error"]
Use = Literal["motion", "frequency", "sweep", "tuning", "check"]
Control = Literal["open", "servo"]


@dataclass(frozen=True, slots=True)
class Arm:
    """The arm as a whole: `[arm]`."""

    kind: ArmKind
    link_length: Positive | None = None  # l_1 [m], joint 1 axis to joint 2 axis
    gravity: NonNegative | None = None  # [m/s^2] along -y in the plane of motion


@dataclass(frozen=True, slots=True)
class Imu:
    """Accelerometers and gyros in one case on a joint's link, placed anywhere."""

    xyz: tuple[float, float, float] | None = None  # [m] in the link's frame
    rpy: tuple[float, float, float] | None = None  # [rad] roll, pitch and yaw, as in URDF
    accelerometer_hz: Positive | None = None  # second-order Butterworth
    gyro_hz: Positive | None = None  # second-order Butterworth


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint's drive and sensors: `[[joint]]`."""

    spring: Spring
    gear_ratio: Positive  # n, link turns per motor turn
    motion: Motion = "revolute"
    torque_per_volt: Positive | None = None  # e [N m/V] at the motor
    current_loop_hz: Positive | None = None
    encoder_counts: Positive | None = None  # per motor turn
    accelerometer_distance: Positive | None = None  # l_a [m]; left out: estimated
    accelerometer_hz: Positive | None = None  # second-order Butterworth
    gyro_hz: Positive | None = None  # first order
    imu: Imu | None = None
    effects: tuple[Effect, ...] = ()  # that its friction and gear may have


@dataclass(frozen=True, slots=True)
class Servo:
    """PI velocity servo: u = kp e + ki integral(e), e = reference - encoder difference / period."""

    kind: Literal["pi-velocity"]
    period: Positive  # [s]
    kp: tuple[NonNegative, ...]  # [V s/rad], one per joint
    ki: tuple[NonNegative, ...]  # [V/rad], one per joint
    limit: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a channel comes from: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """Where a channel comes from in a bag: a number in each message of a topic."""

    topic: Annotated[str, MinLen(1)]
    field: Annotated[str, MinLen(1)]  # as in a message: "position", "data[0]", "a.b.c"
    name: str | None = None  # of the joint, where the field has one number a joint
    scale: float = 1.0
    offset: float = 0.0

    @property
    def channel(self) -> Channel:
        """The same, with the name that the bag's reader gives to the column."""
        at = "" if self.name is None else f"[{self.name}]"
        return Channel(f"{self.topic}.{self.field}{at}", self.scale, self.offset)


@dataclass(frozen=True, slots=True)
class Prbs:
    """A maximum-length binary sequence, `2**order - 1` clocks long."""

    order: Annotated[int, Ge(2)]
    clock: Positive  # [s]
    periods: Annotated[int, Ge(1)]
    amplitude: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One log file and what it is for: `[[experiment]]`."""

    name: Annotated[str, MinLen(1)]
    file: Annotated[str, MinLen(1)]  # beside the study file
    use: Use
    control: tuple[Control, ...]  # one per joint
    joint: Annotated[int, Ge(1)] | None = None  # the excited joint, from 1
    prbs: Prbs | None = None
    start: float | None = None  # [s]
    stop: float | None = None  # [s]
    add: Mapping[str, str] = field(default_factory=dict)  # channel -> column added to it


@dataclass(frozen=True, slots=True)
class Study:
    """A whole study file, checked."""

    path: Path
    sha256: str
    arm: Arm
    joints: tuple[Joint, ...]
    experiments: tuple[Experiment, ...]
    servo: Servo | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    options: Options = field(default_factory=Options)  # of the stages: `[options]`

    @property
    def n_joints(self) -> int:
        """Joints of the arm."""
        return len(self.joints)

    def log_path(self, experiment: Experiment) -> Path:
        """Where an experiment's log lies: beside the study file."""
        return self.path.parent / experiment.file


CHANNELS = (
    *("u", "torque", "theta_m", "omega_m", "a", "theta_l", "deflection", "gyro", "ref"),
    *("ax", "ay", "az", "gx", "gy", "gz"),  # of an IMU
)
"""Channels there is one of per joint; `t` stands alone."""


def channel_names(count: int) -> tuple[str, ...]:
    """Every channel an arm of `count` joints can have.

    Parameters
    ----------
    count : int

    Returns
    -------
    tuple of str
    """
    return ("t", *(f"{name}{i}" for name in CHANNELS for i in range(1, count + 1)))
