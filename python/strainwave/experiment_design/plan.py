"""What a design is made of: limits in, planned records with their predicted motion out."""

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

FREE: Control = "open"
HELD: Control = "servo"
ADD_SERVO = (
    'add [servo] to the study, as the drives have it: kind = "pi-velocity", period [s], '
    "kp [V s/rad] and ki [V/rad] one per joint, limit [V]"
)
_WHOLE_TURN = 2.0 * np.pi  # [rad] of a link: more to either side are degrees, most likely
_FASTEST = 2000.0  # [rad/s], 19,000 rpm: beyond the servo motors of robots
_USUAL_CLOCK = 1e-3  # [s] of a drive whose servo is not described


@dataclass(frozen=True, slots=True)
class Limits:
    """What no experiment may exceed, one number a joint."""

    angle: tuple[float, ...]  # [rad] of the link, to both sides of zero
    velocity: tuple[float, ...]  # [rad/s] of the motor
    voltage: tuple[float, ...]  # [V] of the drive; [N m] where torque is commanded
    gear_torque: tuple[float, ...]  # [N m] at the link; infinite: not asked for


@dataclass(frozen=True, slots=True)
class PredictedMotion:
    """What the guessed arm does in a record, one number a joint."""

    angle: FloatArray  # (n_joints,) [rad] largest magnitude of the link's
    velocity: FloatArray  # (n_joints,) [rad/s] of the motor's
    voltage: FloatArray  # (n_joints,) [V]
    gear_torque: FloatArray  # (n_joints,) [N m]
    rest_share: FloatArray  # (n_joints,) part of the time in which the motor stands

    def use_of(self, limits: Limits) -> float:
        """The largest share of any limit that is used; above one, a limit is broken."""
        return max(float((used / limit).max()) for *_, used, limit in self._beside(limits))

    def broken(self, limits: Limits) -> str:
        """Which limits are broken, by how much, and what would do instead; empty: none."""
        found = [
            f"the {what} of joint {i + 1} would be {used[i]:.3g} {unit} "
            f"of {limit[i]:.3g} ({option})"
            for what, unit, option, used, limit in self._beside(limits)
            for i in range(len(used))
            if used[i] > limit[i]
        ]
        return ", ".join(found)

    def _beside(
        self, limits: Limits
    ) -> tuple[tuple[str, str, str, FloatArray, tuple[float, ...]], ...]:
        """What it is called, its unit and option; what is used, and the limit."""
        return (
            ("angle", "rad", "--limit-angle", self.angle, limits.angle),
            ("motor velocity", "rad/s", "--limit-velocity", self.velocity, limits.velocity),
            ("voltage", "V", "--limit-voltage", self.voltage, limits.voltage),
            ("gear torque", "N m", "--limit-torque", self.gear_torque, limits.gear_torque),
        )


class LimitBroken(InvalidInput):
    """No size of an experiment keeps the guessed arm within its limits."""


@dataclass(frozen=True, slots=True)
class Planned:
    """One record to be taken."""

    experiment: Experiment
    drive: Drive
    motor_angle: FloatArray | None  # (n_ticks, n_joints) [rad] that is meant; None: not prescribed
    band_hz: tuple[float, float]  # in which the arm is excited
    predicted: PredictedMotion
    reasons: tuple[str, ...]  # how long, and why, a sentence each
    condition_number: float | None = None  # of the rigid regressor, columns scaled

    @property
    def duration(self) -> float:
        """[s] of the whole record."""
        return len(self.drive.voltage) * self.drive.tick


@dataclass(frozen=True, slots=True)
class Design:
    """All records of an arm, and what to know before they are taken."""

    study: Study  # with the planned experiments, whose logs are still to be recorded
    limits: Limits
    records: tuple[Planned, ...]
    warnings: tuple[Diagnostic, ...]
    precision: tuple[Parameter, ...] = ()  # that the whole-arm fit would have, at the guess


def limits_of(
    arm: ArmDescription, angle: str, velocity: str, voltage: str | None, gear_torque: str | None
) -> Limits:
    """The limits as they are written on the command line.

    `arm`: Its servo's limit holds as well. `angle`, `velocity`: One number, or one per joint with
    commas between. `voltage`: The servo's limit without; required where there is no servo.
    `gear_torque`: None without. Raises `InvalidInput`: One is not a positive number, or there are
    not as many as joints.
    """
    if voltage is None and arm.servo is None:
        raise InvalidInput(
            "the drives' limit is not known: there is no [servo] table that has it",
            where="--limit-voltage",
            remedy=f"give it in V, or {ADD_SERVO}",
        )
    largest = arm.servo.limit if arm.servo else float("inf")
    top = (largest,) * arm.n_joints
    given = top if voltage is None else _numbers(voltage, arm.n_joints, "--limit-voltage")
    any_torque = (float("inf"),) * arm.n_joints
    angles = _numbers(angle, arm.n_joints, "--limit-angle")
    velocities = _numbers(velocity, arm.n_joints, "--limit-velocity")
    for i, joint in enumerate(arm.joints):
        if joint.motion == "revolute":
            _check_plausible(angles[i], velocities[i], i + 1)
    return Limits(
        angle=angles,
        velocity=velocities,
        voltage=tuple(min(pair) for pair in zip(given, top, strict=True)),
        gear_torque=any_torque
        if gear_torque is None
        else _numbers(gear_torque, arm.n_joints, "--limit-torque"),
    )


def _check_plausible(angle: float, velocity: float, joint: int) -> None:
    """Refuse limits that look like degrees or revolutions per minute."""
    if angle > _WHOLE_TURN:
        raise InvalidInput(
            f"joint {joint} would be let turn {angle:g} rad, {angle / _WHOLE_TURN:.3g} whole turns "
            "to either side",
            where="--limit-angle",
            remedy=f"give rad: {angle:g} degrees are {np.radians(angle):.4g} rad; a joint that "
            "turns without end gets 6.28 at most",
        )
    if velocity > _FASTEST:
        raise InvalidInput(
            f"the motor of joint {joint} would be let turn at {velocity:g} rad/s, "
            f"{60.0 * velocity / _WHOLE_TURN:.0f} revolutions a minute",
            where="--limit-velocity",
            remedy=f"give rad/s at the motor: {velocity:g} rpm are {velocity * np.pi / 30.0:.4g}",
        )


def clock_of(arm: ArmDescription) -> float:
    """The clock of what is planned [s]: the servo's, or that of a usual drive."""
    return arm.servo.period if arm.servo else _USUAL_CLOCK


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, count) or not all(0.0 < value < float("inf") for value in values):
        raise InvalidInput(
            f"{text!r} is neither one positive number nor {count} with commas between",
            where=option,
            remedy="give one limit for all joints, or one per joint, such as 1.2,0.9",
        )
    return tuple(values * count if len(values) == 1 else values)
