"""The arm as its rig describes it; `strainwave.io.study` checks the `annotated_types`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from annotated_types import Ge, Gt

from strainwave.domain.effects import all_effects
from strainwave.domain.gear_laws import RIGID, GearLaw, gear_law

Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]

ArmKind = Literal["planar-two-link", "single-joint"]
Motion = Literal["revolute", "prismatic"]
Spring = str  # name of a gear law
EffectName = str  # of one of `domain.effects`


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
    # that its friction and gear may have; "auto": those that the records demand
    effects: tuple[EffectName, ...] | Literal["auto"] = ()

    @property
    def law(self) -> GearLaw:
        """The elastic law of its gear."""
        return gear_law(self.spring)

    @property
    def elastic(self) -> bool:
        """Whether its gear gives way between motor and link."""
        return self.law.elastic

    @property
    def selects_effects(self) -> bool:
        """Whether the fit looks for its effects itself."""
        return self.effects == "auto"

    @property
    def named_effects(self) -> tuple[EffectName, ...]:
        """The effects that a study names."""
        return () if self.effects == "auto" else self.effects

    @property
    def possible_effects(self) -> tuple[EffectName, ...]:
        """The effects that it may have: those named, or all that such a gear can have."""
        if self.effects != "auto":
            return self.effects
        return tuple(e.name for e in all_effects() if self.elastic or not e.needs_elastic_gear)


@dataclass(frozen=True, slots=True)
class Servo:
    """PI velocity servo: u = kp e + ki integral(e), e = reference - encoder difference / period.

    With gains of a position loop around it e has position_gain (theta_M(0) + integral(reference) -
    encoder) as well.
    """

    kind: Literal["pi-velocity"]
    period: Positive  # [s]
    kp: tuple[NonNegative, ...]  # [V s/rad], one per joint
    ki: tuple[NonNegative, ...]  # [V/rad], one per joint
    limit: Positive  # [V]
    position_gain: tuple[NonNegative, ...] | None = None  # [1/s], one per joint


@dataclass(frozen=True, slots=True)
class ArmDescription:
    """What is known of an arm before any log: `[arm]`, its `[[joint]]` tables and `[servo]`."""

    kind: ArmKind
    joints: tuple[Joint, ...]  # from the base
    link_length: Positive | None = None  # l_1 [m], joint 1 axis to joint 2 axis
    gravity: NonNegative | None = None  # [m/s^2] along -y in the plane of motion
    servo: Servo | None = None

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def with_joints(self, joints: Iterable[Joint]) -> Self:
        """The same arm with other joints."""
        return replace(self, joints=tuple(joints))

    def behind_rigid_gears(self) -> Self:
        """The same arm with gears that neither give way nor have effects."""
        return self.with_joints(replace(j, spring=RIGID, effects=()) for j in self.joints)
