"""Records of a design: limits, planned records and their predicted motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from strainwave.domain import (
    ArmDescription,
    Control,
    Diagnostic,
    Experiment,
    FloatArray,
    JointLimits,
    Parameter,
    Study,
)
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""(n_samples, n_joints) link angles, velocities, accelerations."""

FREE_CONTROL: Control = "open"
HELD_CONTROL: Control = "servo"
ADD_SERVO = (
    'add the [servo] of the drives to the study: kind = "pi-velocity", period [s], '
    "kp [V s/rad] and ki [V/rad] for each joint, limit [V]"
)
LIMITED = (
    ("angle", "angle", "rad", "--limit-angle"),
    ("velocity", "motor velocity", "rad/s", "--limit-velocity"),
    ("voltage", "voltage", "V", "--limit-voltage"),
    ("gear_torque", "gear torque", "N m", "--limit-torque"),
)
"""Field of `Limits` and `PredictedMotion`, name, unit and option of each limited quantity."""

_MAX_ANGLE_LIMIT = 2.0 * np.pi  # [rad] of a link; a larger limit is probably in degrees
_MAX_VELOCITY_LIMIT = 2000.0  # [rad/s] 19,000 rpm, more than servo motors of robots reach
_MAX_OWN_ANGLE = np.pi  # [rad] of a revolute joint's own limits; cables and tools have less
_MIN_DISTANCE = 1e-9  # [m] that avoids division by zero
_DEFAULT_CLOCK = 1e-3  # [s] of a drive whose servo is not described


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of all experiments, one number per joint."""

    angle: tuple[float, ...]  # [rad] of the link, to both sides of `posture`
    velocity: tuple[float, ...]  # [rad/s] of the motor
    voltage: tuple[float, ...]  # [V] of the drive; [N m] if torque is commanded
    gear_torque: tuple[float, ...]  # [N m] link side; infinite: no limit
    # [rad] link angles from which `angle` counts and at which records begin; empty: zeros
    posture: tuple[float, ...] = ()
    distance: float = 0.0  # [m] smallest between the centre lines of two links

    @property
    def centre(self) -> FloatArray:
        """Link angles in the middle of the limits: (n_joints,) [rad]."""
        return np.array(self.posture or (0.0,) * len(self.angle))


@dataclass(frozen=True, slots=True)
class PredictedMotion:
    """Peak values of a simulated record of the guessed arm."""

    angle: FloatArray  # (n_joints,) [rad] of the links, from the limits' posture
    velocity: FloatArray  # (n_joints,) [rad/s] of the motors
    voltage: FloatArray  # (n_joints,) [V]
    gear_torque: FloatArray  # (n_joints,) [N m]
    rest_share: FloatArray  # (n_joints,) share of the time in which the motor sticks
    distance: float  # [m] smallest between two links; infinite if none can touch

    def use_of(self, limits: Limits) -> float:
        """Largest value over its limit; above 1 a limit is violated."""
        of_joints = max(
            float((getattr(self, key) / getattr(limits, key)).max()) for key, *_ in LIMITED
        )
        return max(of_joints, limits.distance / max(self.distance, _MIN_DISTANCE))

    def broken(self, limits: Limits) -> str:
        """Text of the violated limits with their options; empty if none is violated."""
        texts = [
            f"the {name} of joint {i} would be {value:.3g} {unit}, above the limit of {limit:.3g} "
            f"({option})"
            for key, name, unit, option in LIMITED
            for i, (value, limit) in enumerate(
                zip(getattr(self, key), getattr(limits, key), strict=True), start=1
            )
            if value > limit
        ]
        if self.distance < limits.distance:
            texts.append(
                f"the distance of two links would be {self.distance:.3g} m, below the limit of "
                f"{limits.distance:.3g} (--limit-distance)"
            )
        return ", ".join(texts)


class LimitBroken(InvalidInput):
    """No amplitude of an experiment keeps the guessed arm within its limits."""


@dataclass(frozen=True, slots=True)
class Planned:
    """One record to be recorded."""

    experiment: Experiment
    drive: Drive
    motor_angle: FloatArray | None  # (n_ticks, n_joints) [rad] intended; None: not prescribed
    band_hz: tuple[float, float]  # of the excitation
    predicted: PredictedMotion
    reasons: tuple[str, ...]  # of excitation and duration, one clause each
    condition_number: float | None = None  # of the rigid regressor, columns scaled
    precision: tuple[Parameter, ...] = ()  # predicted for the rigid step with this record alone
    waypoints: tuple[FloatArray, Motion] | None = None  # of a smooth motion: times [s], links

    @property
    def duration(self) -> float:
        """Duration [s] of the record."""
        return len(self.drive.voltage) * self.drive.tick


@dataclass(frozen=True, slots=True)
class Design:
    """All planned records of an arm, with warnings."""

    study: Study  # with the planned experiments, whose logs do not exist yet
    limits: Limits
    records: tuple[Planned, ...]
    warnings: tuple[Diagnostic, ...]
    precision: tuple[Parameter, ...] = ()  # predicted for the whole-arm fit
    omitted: tuple[str, ...] = ()  # records for which the allowed duration is too short
    # joint -> error of its torque over the rms value that a result measured; others are assumed
    torque_errors: Mapping[int, float] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Duration [s] of all records."""
        return sum(record.duration for record in self.records)


def follows_angles(arm: ArmDescription) -> bool:
    """Whether the design has motions that the arm's own controller follows.

    No servo is described, and in open loop the arm would fall, or has no gear to excite.
    """
    is_free = not arm.gravity and any(joint.elastic for joint in arm.joints)
    return arm.servo is None and not is_free


def limits_of(
    arm: ArmDescription,
    angle: str | None,
    velocity: str | None,
    voltage: str | None,
    gear_torque: str | None,
    *,
    distance: str | None = None,
) -> Limits:
    """Limits from texts of the command line: one positive number, or one per joint with commas.

    The limits of the joints, from the study or its URDF, apply in addition, and the servo's to the
    voltage. Without a servo a voltage limit is required, or limits of the torques of an arm that
    `follows_angles`. A torque limit of a rigid joint limits its voltage. Raises InvalidInput if a
    number is missing, not positive or implausible.
    """
    is_led = follows_angles(arm)
    if voltage is None and arm.servo is None and not is_led:
        raise InvalidInput(
            "the voltage limit of the drives is unknown because the study has no [servo] table",
            where="--limit-voltage",
            remedy=f"set it in V, or {ADD_SERVO}",
        )
    unlimited = (np.inf,) * arm.n_joints

    def numbers(text: str | None, option: str) -> tuple[float, ...]:
        return unlimited if text is None else _numbers(text, arm.n_joints, option)

    angles = numbers(angle, "--limit-angle")
    velocities = numbers(velocity, "--limit-velocity")
    for i, joint in enumerate(arm.joints):
        if joint.motion == "revolute":
            _check_plausible(angles[i], velocities[i], i + 1)
    own = [joint.limits or JointLimits() for joint in arm.joints]
    ratios = [abs(joint.gear_ratio) for joint in arm.joints]
    lowest = [-np.inf if each.lower is None else each.lower for each in own]
    highest = [np.inf if each.upper is None else each.upper for each in own]
    low, high = np.maximum(lowest, -np.array(angles)), np.minimum(highest, angles)
    if angle is None:
        _check_own_limits(arm, low, high)
    links = np.array([each.velocity or np.inf for each in own])
    motors = np.minimum(velocities, links / ratios)
    _check_limited(high - low, "the angle of joint", "--limit-angle", "rad")
    _check_limited(motors, "the velocity of joint", "--limit-velocity", "rad/s of the motor")
    gears = np.minimum(
        numbers(gear_torque, "--limit-torque"), [each.effort or np.inf for each in own]
    )
    top = arm.servo.limit if arm.servo else np.inf
    voltages = np.minimum(numbers(voltage, "--limit-voltage"), top)
    for i, joint in enumerate(arm.joints):
        if is_led or not joint.elastic:  # the gear transmits what the motor gives
            voltages[i] = min(voltages[i], gears[i] * ratios[i] / joint.torque_per_command)
    _check_limited(voltages, "the torque of joint", "--limit-torque", "N m at the joint")
    centre = 0.5 * (low + high)
    return Limits(
        angle=tuple((0.5 * (high - low)).tolist()),
        velocity=tuple(motors.tolist()),
        voltage=tuple(voltages.tolist()),
        gear_torque=tuple(gears.tolist()),
        posture=tuple(centre.tolist()) if centre.any() else (),
        distance=0.0 if distance is None else _numbers(distance, 1, "--limit-distance")[0],
    )


def _check_own_limits(arm: ArmDescription, low: FloatArray, high: FloatArray) -> None:
    """Raise InvalidInput if the own limits of a revolute joint allow more than half a turn."""
    largest = np.maximum(-low, high)
    is_wide = (largest > _MAX_OWN_ANGLE) & [joint.motion == "revolute" for joint in arm.joints]
    if is_wide.any():
        numbers = ", ".join(map(str, np.flatnonzero(is_wide) + 1))
        place = "limits = { lower = -1.5, upper = 1.5 } in the [[joint]] tables"
        if arm.urdf is not None:
            place = "lower and upper of the <limit> in the URDF"
        example = ",".join(f"{size:.3g}" for size in np.where(is_wide, 1.5, largest))
        raise InvalidInput(
            f"the study and its URDF limit the angle of joint {numbers} to more than half a turn on"
            " a side, or not at all",
            where="--limit-angle",
            remedy="set the angles [rad] that cables, tools and surroundings allow, one per joint, "
            f"such as --limit-angle {example}, or {place}",
        )


def _check_limited(ranges: FloatArray, quantity: str, option: str, unit: str) -> None:
    """Raise InvalidInput if a range is infinite or empty."""
    for number, value in enumerate(ranges.tolist(), start=1):
        if np.isinf(value):
            raise InvalidInput(
                f"{quantity} {number} has no limit",
                where=option,
                remedy=f"set the limits in {unit}, here, in the URDF that the study names, or as "
                "limits of its [[joint]] tables",
            )
        if value <= 0.0:
            raise InvalidInput(
                f"the limit of {quantity} {number} excludes all that the study or its URDF permits",
                where=option,
                remedy="widen it, or correct the limits in the study or the URDF",
            )


def _check_plausible(angle: float, velocity: float, joint: int) -> None:
    """Raise InvalidInput if a limit seems to be in degrees or revolutions per minute.

    An infinite limit is not given.
    """
    if _MAX_ANGLE_LIMIT < angle < np.inf:
        raise InvalidInput(
            f"the angle limit of joint {joint} is {angle:g} rad, more than a full turn in each "
            "direction",
            where="--limit-angle",
            remedy=f"use rad: {angle:g} degrees are {np.radians(angle):.4g} rad; the largest "
            "limit, for a joint without stops, is 6.28",
        )
    if _MAX_VELOCITY_LIMIT < velocity < np.inf:
        raise InvalidInput(
            f"the velocity limit of joint {joint} is {velocity:g} rad/s, "
            f"{velocity * 30.0 / np.pi:.0f} rpm at the motor",
            where="--limit-velocity",
            remedy=f"use rad/s of the motor: {velocity:g} rpm are {velocity * np.pi / 30.0:.4g} "
            "rad/s",
        )


def clock_of(arm: ArmDescription) -> float:
    """Clock [s] of the planned inputs: the servo's, or that of a common drive."""
    return arm.servo.period if arm.servo else _DEFAULT_CLOCK


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, count) or not all(0.0 < value < float("inf") for value in values):
        raise InvalidInput(
            f"{text!r} is neither one positive number nor {count} numbers with commas",
            where=option,
            remedy="set one limit for all joints, or one per joint, such as 1.2,0.9",
        )
    return tuple(values * count if len(values) == 1 else values)
