"""Interface of a link sensor: its channels, the simulated quantities it reads, its constants.

A sensor maps link motion and torsion to a reading

    y(t) = s x(t - D) + bias + r (t - t_m)

x is a weighted sum of simulated quantities behind the sensor's low-pass and after the resonance of
its mount, if it has one. t_m is the middle of the record.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache, cached_property
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np

from strainwave.domain.arm.description import Joint
from strainwave.domain.arm.link_sensors.link_space import LINK_SIGNALS, PLANE, LinkSpace, Quantity
from strainwave.domain.arm.parameter_table import of_record
from strainwave.domain.keys import FloatArray, JointNumber, Key

MOTOR_ENCODER_DELAY = "motor_encoder_delay"
TORQUE_HOLD = "torque_hold"
"""Sensor constants of a motor: what is unknown of its logged torque."""

_DIFFERENCE_STEP = 1e-6  # of central differences: weights are smooth, of the order of one


class ConstantKind(Enum):
    """Kind of a sensor constant; the value ends its name."""

    DELAY = "delay"
    SCALE = "scale"
    DRIFT = "drift"
    HOLD = "hold"
    BANDWIDTH = "bandwidth"
    MOUNT_FREQUENCY = "mount_frequency"
    MOUNT_DAMPING = "mount_damping"
    TILT = "tilt"
    DISTANCE = "distance"
    POSITION_X = "x"
    POSITION_Y = "y"
    POSITION_Z = "z"
    BEARING = "bearing"
    ROTATION_X = "turn_x"
    ROTATION_Y = "turn_y"
    ROTATION_Z = "turn_z"
    SHARE = "share"
    START_ROLL = "start_roll"
    START_PITCH = "start_pitch"
    START_YAW = "start_yaw"
    ROLL = "roll"
    PITCH = "pitch"
    YAW = "yaw"

    @property
    def nominal(self) -> float:
        """Value for an ideal sensor; bandwidth and mount frequency are infinite."""
        return _NOMINAL.get(self, 0.0)


K = ConstantKind
Kinds = tuple[ConstantKind, ...]
_HIDDEN = frozenset({K.BEARING, K.ROTATION_X, K.ROTATION_Y, K.ROTATION_Z, K.SHARE})
_MOUNTING = _HIDDEN | {K.DISTANCE, K.TILT, K.POSITION_X, K.POSITION_Y, K.POSITION_Z}
_NOMINAL = {K.SCALE: 1.0, K.BANDWIDTH: np.inf, K.MOUNT_FREQUENCY: np.inf}
_PER_SECOND = {"m/s^2": "m/s^3", "rad/s": "rad/s^2", "N m": "N m/s"}
# unit, symbol and description of the constants of every sensor
_COMMON_TEXTS = {
    K.DELAY: ("s", "D", "delay of the {} relative to the {}"),
    K.HOLD: ("1", "h", "share of the {} that is held between samples"),
    K.BANDWIDTH: ("Hz", "", "bandwidth of the {}"),
    K.MOUNT_FREQUENCY: ("Hz", "f_h", "natural frequency of the mount of the {}"),
    K.MOUNT_DAMPING: ("1", "zeta_h", "damping ratio of the mount of the {}"),
    K.SCALE: ("1", "s", "scale factor of the {}"),
    K.DRIFT: ("", "r", "drift of the bias of the {} in one record"),
}
_OPTIONAL = frozenset({*_COMMON_TEXTS, K.TILT})


@dataclass(frozen=True, slots=True)
class SensorConstant:
    """A constant of a type of sensor, on any joint."""

    owner: str  # the sensor, or its axis, in names
    kind: ConstantKind
    unit: str
    description: str = ""
    symbol: str = ""

    @property
    def name(self) -> str:
        """Name in docs/notation.md and in results."""
        return f"{self.owner}_{self.kind.value}"

    def key(self, joint: int, record: str | None = None) -> Key:
        """Name and joint; a drift belongs to one record."""
        return self.name if record is None else of_record(self.name, record), joint

    @property
    def is_optional(self) -> bool:
        """Whether a fit includes the constant only if the data support it."""
        return self.kind in _OPTIONAL

    @property
    def is_mounting(self) -> bool:
        """Whether the constant is a position or an attitude, which changes the weights."""
        return self.kind in _MOUNTING

    @property
    def is_hidden(self) -> bool:
        """Whether it is internal to the fit; results report position and attitude instead."""
        return self.kind in _HIDDEN

    @property
    def is_of_mount(self) -> bool:
        """Whether it describes the resonance of the sensor's mount."""
        return self.kind in (K.MOUNT_FREQUENCY, K.MOUNT_DAMPING)


class SensorGroup(Enum):
    """Sensors of one joint that replace each other in a fit, in the order of the channels."""

    MOTOR = "motor motion"
    MOTION = "link motion, as one simulated quantity"
    MOUNTED = "link motion, as a combination of quantities that depends on the mounting"
    TORQUE = "joint torque"


class LinkSensor(ABC):
    """A sensor on a link, with the constants that the `[[joint]]` table gives.

    Sensors are values: those of equal joints are equal.
    """

    name: ClassVar[str]  # in sensor constants
    noun: ClassVar[str]  # in descriptions of its constants
    channel_kinds: ClassVar[tuple[str, ...]]  # channels without the joint's number, one per axis
    unit: ClassVar[str]  # SI unit of a reading
    prismatic_unit: ClassVar[str | None] = None  # on a prismatic joint, if it differs
    measurand: ClassVar[str]  # noun of what it measures, in reports
    suggested_as: ClassVar[str] = ""  # noun and article, in a report that suggests the sensor
    # of a `[[joint]]` table that describe it: key -> title in reports, and unit
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {}
    by_channel: ClassVar[bool] = False  # the channels of a study alone state that a link has it
    bandwidth_key: ClassVar[str | None] = None  # key of its bandwidth [Hz] in the table
    low_pass_order: ClassVar[Literal[1, 2]] = 2  # 2: Butterworth
    reads_angle: ClassVar[bool] = False  # compared as a velocity: open-loop angles drift
    has_bias: ClassVar[bool] = True  # unknown
    time_reference: ClassVar[str] = "motor encoder"  # to which its delay is relative
    common: ClassVar[Kinds] = (K.DELAY, K.BANDWIDTH, K.MOUNT_FREQUENCY, K.MOUNT_DAMPING)
    per_axis: ClassVar[Kinds] = (K.SCALE, K.DRIFT)  # `common` are those that all axes share
    symbols: ClassVar[bool] = True  # docs/notation.md has those of delay, scale and drift

    @classmethod
    @abstractmethod
    def of_joint(cls, joint: Joint) -> Self | None:
        """The sensor on the link of a joint; None if the joint cannot have it."""

    @abstractmethod
    def quantities(self) -> tuple[Quantity, ...]:
        """Simulated quantities that each axis reads."""

    def axes(self, joint: int, space: LinkSpace = PLANE) -> tuple[SensorAxis, ...]:
        """All axes of the sensor on the link of a joint, which moves in `space`."""
        numbers = range(len(self.channel_kinds))
        return tuple(SensorAxis(self, joint, number, space) for number in numbers)

    def low_passes(self) -> Mapping[str, float | None]:
        """Low-passes [Hz] of the core that its quantities pass, by argument; None: no low-pass."""
        return {}

    @property
    def hz(self) -> float | None:
        """Bandwidth [Hz] of the table; None if it gives none."""
        return None

    @property
    def is_in_table(self) -> bool:
        """Whether the table alone states that the link has the sensor."""
        return False

    @property
    def resolution(self) -> float:
        """One count of a reading; zero if unknown or without counts."""
        return 0.0

    @property
    def group(self) -> SensorGroup | None:
        """Group of the sensor; None: a fit does not compare its readings as they are."""
        return SensorGroup.MOTION

    @property
    def rank(self) -> int:
        """Order in the group; a fit compares those of least rank."""
        return 0

    def with_bandwidth(self, joint: Joint, hz: float) -> Joint:
        """The joint's table with another bandwidth of the sensor."""
        changes: dict[str, Any] = {} if self.bandwidth_key is None else {self.bandwidth_key: hz}
        return replace(joint, **changes)

    def with_place(self, joint: Joint, number: JointNumber, values: Mapping[Key, float]) -> Joint:
        """The table of a joint with the estimated place of the sensor."""
        return joint

    @classmethod
    def typical(cls, joint: Joint, length: float) -> TypicalSensor | None:
        """A typical sensor for a link of this length [m]; None if none is suggested."""
        return None

    def weights(self, axis: SensorAxis, values: Mapping[Key, float]) -> FloatArray:
        """Weights of all `quantities` for values of the mounting's unknowns."""
        return np.ones(1)

    def unknowns(self, axes: Sequence[SensorAxis]) -> list[Key]:
        """Unknowns of the mounting of one link's logged axes, in the coordinates of a fit."""
        return []

    def is_scale_identifiable(self, axis: SensorAxis, axes: Sequence[SensorAxis]) -> bool:
        """Whether the scale of an axis is identifiable in addition to the mounting of `axes`."""
        return True

    def report(
        self, axes: Sequence[SensorAxis], values: Mapping[Key, float]
    ) -> dict[str, tuple[float, str]]:
        """Position and attitude as far as they follow from unknowns: value and unit by name."""
        return {}

    @classmethod
    def axis_noun(cls, number: int) -> str:
        """Noun of one axis."""
        return cls.noun

    @classmethod
    def owner(cls, number: int) -> str:
        """Owner of the constants of one axis, in names."""
        return cls.name

    @classmethod
    def extra_constants(cls) -> tuple[SensorConstant, ...]:
        """Further constants, such as those of the mounting."""
        return ()

    @classmethod
    @cache
    def constants(cls) -> tuple[SensorConstant, ...]:
        """All constants of sensors of this type."""
        common = [cls._constant(cls.name, cls.noun, kind) for kind in cls.common]
        of_axes = [
            cls._constant(cls.owner(number), cls.axis_noun(number), kind)
            for number in range(len(cls.channel_kinds))
            for kind in cls.per_axis
        ]
        return (*common, *of_axes, *cls.extra_constants())

    @classmethod
    @cache
    def constant(cls, kind: ConstantKind, number: int = 0) -> SensorConstant | None:
        """Constant of a kind of one axis; None if it has none."""
        owners = (cls.owner(number), cls.name)
        return next((c for c in cls.constants() if c.kind is kind and c.owner in owners), None)

    @classmethod
    def _constant(cls, owner: str, noun: str, kind: ConstantKind) -> SensorConstant:
        unit, symbol, text = _COMMON_TEXTS[kind]
        unit = _PER_SECOND[cls.unit] if kind is K.DRIFT else unit
        constant = SensorConstant(owner, kind, unit, text.format(noun, cls.time_reference), symbol)
        return constant if cls.symbols or constant.is_of_mount else replace(constant, symbol="")


@dataclass(frozen=True, slots=True)
class TypicalSensor:
    """A typical sensor for a link that has none."""

    joint: Joint  # the joint's table with the sensor
    specification: str  # as text
    noise_density: float = 0.0  # per root of Hz
    resolution: float = 0.0

    def sample_std(self, sample_time: float) -> float:
        """Standard deviation of the noise of a sample."""
        noise = self.noise_density * np.sqrt(0.5 / sample_time)
        return float(np.hypot(noise, self.resolution / np.sqrt(12.0)))


@dataclass(frozen=True)
class SensorAxis:
    """One axis of a sensor on the link of a joint."""

    sensor: LinkSensor
    joint: JointNumber
    number: int = 0
    space: LinkSpace = PLANE  # in which the link moves

    @property
    def channel(self) -> str:
        """Channel of its readings."""
        return f"{self.sensor.channel_kinds[self.number]}{self.joint}"

    @property
    def reads_angle(self) -> bool:
        """Whether its reading is an angle, which is compared as a velocity."""
        return self.sensor.reads_angle

    @property
    def is_mounted(self) -> bool:
        """Whether its reading depends on a mounting."""
        return self.sensor.group is SensorGroup.MOUNTED

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Simulated quantities that it reads."""
        return tuple(name for name in self.sensor.quantities() if self.space.has(name))

    @cached_property
    def summed_quantity(self) -> Quantity:
        """The quantity that the core records instead of several that it sums with weights."""
        if len(self.quantities) == 1:
            return self.quantities[0]
        return cast(Quantity, f"imu_{self.sensor.channel_kinds[self.number]}")

    @cached_property
    def is_simulated(self) -> list[bool]:
        """Whether the simulation has each quantity of the sensor."""
        return [self.space.has(name) for name in self.sensor.quantities()]

    def key(self, kind: ConstantKind, record: str | None = None) -> Key | None:
        """Key of one of its constants; None if it has none of this kind."""
        constant = self.sensor.constant(kind, self.number)
        return constant.key(self.joint, record) if constant else None

    def value(
        self, kind: ConstantKind, values: Mapping[Key, float], record: str | None = None
    ) -> float:
        """Value of one of its constants; that of an ideal sensor if it is not in `values`."""
        key = self.key(kind, record)
        return values.get(key, kind.nominal) if key else kind.nominal

    @cached_property
    def delays(self) -> tuple[Key, ...]:
        """Keys of the delays whose sum is the delay to the motor's input.

        The delay of a link sensor is relative to the motor encoder of its joint.
        """
        own = self.key(K.DELAY)
        keys = ((MOTOR_ENCODER_DELAY, self.joint), own)
        return tuple(dict.fromkeys(key for key in keys if key is not None))

    def delay(self, values: Mapping[Key, float]) -> float:
        """Delay [s] of the reading to the motor's input."""
        return sum(values.get(key, 0.0) for key in self.delays)

    @cached_property
    def mount(self) -> tuple[Key, Key] | None:
        """Natural frequency and damping ratio of the sensor's mount; None if it has none."""
        frequency, damping = self.key(K.MOUNT_FREQUENCY), self.key(K.MOUNT_DAMPING)
        return (frequency, damping) if frequency and damping else None

    def weights(self, values: Mapping[Key, float]) -> FloatArray:
        """Weights (n_quantities,) of its quantities in the reading."""
        return self.sensor.weights(self, values)[self.is_simulated]

    def reading(self, of: Mapping[Quantity, FloatArray], values: Mapping[Key, float]) -> FloatArray:
        """Ideal reading (n, ...) from (n, n_joints, ...) of each quantity, or of their sum."""
        if self.summed_quantity in of and len(self.quantities) > 1:
            return of[self.summed_quantity][:, self.joint - 1]
        parts = [of[name][:, self.joint - 1] for name in self.quantities]
        pairs = zip(self.weights(values), parts, strict=True)
        return np.asarray(sum(weight * part for weight, part in pairs))

    def factor(self, values: Mapping[Key, float]) -> float:
        """Weight of `summed_quantity` in the reading."""
        return 1.0 if len(self.quantities) > 1 else float(self.weights(values)[0])

    def signal_weights(self, values: Mapping[Key, float]) -> FloatArray:
        """Weights (n_signals,) of all signals of a link in the reading."""
        by_name = dict(zip(self.quantities, self.weights(values).tolist(), strict=True))
        return np.array([by_name.get(name, 0.0) for name in LINK_SIGNALS])

    def slopes(self, values: Mapping[Key, float], keys: Sequence[Key]) -> FloatArray:
        """Derivatives of the weights with respect to mounting unknowns: (n_quantities, n_keys)."""
        derivatives = np.zeros((len(self.quantities), len(keys)))
        for k, key in enumerate(keys):
            if key[1] == self.joint:
                value, step = values.get(key, 0.0), _DIFFERENCE_STEP
                high, low = (self.weights({**values, key: value + s}) for s in (step, -step))
                derivatives[:, k] = (high - low) / (2.0 * step)
        return derivatives
