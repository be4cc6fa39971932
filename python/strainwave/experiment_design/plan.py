"""Records of a design: limits, planned records and their predicted motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import (
    ArmDescription,
    Control,
    Diagnostic,
    Experiment,
    FloatArray,
    Parameter,
    Study,
)
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput

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
_DEFAULT_CLOCK = 1e-3  # [s] of a drive whose servo is not described


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of all experiments, one number per joint."""

    angle: tuple[float, ...]  # [rad] magnitude of the link angle
    velocity: tuple[float, ...]  # [rad/s] of the motor
    voltage: tuple[float, ...]  # [V] of the drive; [N m] if torque is commanded
    gear_torque: tuple[float, ...]  # [N m] link side; infinite: no limit


@dataclass(frozen=True, slots=True)
class PredictedMotion:
    """Peak values of a simulated record of the guessed arm."""

    angle: FloatArray  # (n_joints,) [rad] of the links
    velocity: FloatArray  # (n_joints,) [rad/s] of the motors
    voltage: FloatArray  # (n_joints,) [V]
    gear_torque: FloatArray  # (n_joints,) [N m]
    rest_share: FloatArray  # (n_joints,) share of the time in which the motor sticks

    def use_of(self, limits: Limits) -> float:
        """Largest value over its limit; above 1 a limit is violated."""
        return max(float((getattr(self, key) / getattr(limits, key)).max()) for key, *_ in LIMITED)

    def broken(self, limits: Limits) -> str:
        """Text of the violated limits with their options; empty if none is violated."""
        return ", ".join(
            f"the {name} of joint {i} would be {value:.3g} {unit}, above the limit of {limit:.3g} "
            f"({option})"
            for key, name, unit, option in LIMITED
            for i, (value, limit) in enumerate(
                zip(getattr(self, key), getattr(limits, key), strict=True), start=1
            )
            if value > limit
        )


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


def limits_of(
    arm: ArmDescription, angle: str, velocity: str, voltage: str | None, gear_torque: str | None
) -> Limits:
    """Limits from texts of the command line: one positive number, or one per joint with commas.

    The servo's limit applies to the voltage in addition; without a servo a voltage limit is
    required. Raises InvalidInput if a number is missing, not positive or implausible.
    """
    if voltage is None and arm.servo is None:
        raise InvalidInput(
            "the voltage limit of the drives is unknown because the study has no [servo] table",
            where="--limit-voltage",
            remedy=f"set it in V, or {ADD_SERVO}",
        )
    unlimited = (float("inf"),) * arm.n_joints

    def numbers(text: str | None, option: str) -> tuple[float, ...]:
        return unlimited if text is None else _numbers(text, arm.n_joints, option)

    angles = numbers(angle, "--limit-angle")
    velocities = numbers(velocity, "--limit-velocity")
    for i, joint in enumerate(arm.joints):
        if joint.motion == "revolute":
            _check_plausible(angles[i], velocities[i], i + 1)
    top = arm.servo.limit if arm.servo else float("inf")
    voltages = tuple(min(each, top) for each in numbers(voltage, "--limit-voltage"))
    return Limits(angles, velocities, voltages, numbers(gear_torque, "--limit-torque"))


def _check_plausible(angle: float, velocity: float, joint: int) -> None:
    """Raise InvalidInput if a limit seems to be in degrees or revolutions per minute."""
    if angle > _MAX_ANGLE_LIMIT:
        raise InvalidInput(
            f"the angle limit of joint {joint} is {angle:g} rad, more than a full turn in each "
            "direction",
            where="--limit-angle",
            remedy=f"use rad: {angle:g} degrees are {np.radians(angle):.4g} rad; the largest "
            "limit, for a joint without stops, is 6.28",
        )
    if velocity > _MAX_VELOCITY_LIMIT:
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
