"""What a design is made of: limits in, planned records with what is foreseen of them out."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.errors import InvalidInput
from strainwave.records import Caution, Control, Experiment, FloatArray, Servo, Study
from strainwave.simulation import Drive

FREE: Control = "open"
HELD: Control = "servo"


@dataclass(frozen=True, slots=True)
class Limits:
    """What no experiment may exceed, one number a joint."""

    angle: tuple[float, ...]  # [rad] of the link, to both sides of zero
    velocity: tuple[float, ...]  # [rad/s] of the motor
    voltage: tuple[float, ...]  # [V] of the drive; [N m] where torque is commanded
    gear_torque: tuple[float, ...]  # [N m] at the link; infinite: not asked for


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What the guessed arm does in a record, one number a joint."""

    angle: FloatArray  # (n_joints,) [rad] largest magnitude of the link's
    velocity: FloatArray  # (n_joints,) [rad/s] of the motor's
    voltage: FloatArray  # (n_joints,) [V]
    gear_torque: FloatArray  # (n_joints,) [N m]
    rest_share: FloatArray  # (n_joints,) part of the time in which the motor stands

    def use_of(self, limits: Limits) -> float:
        """The largest share of any limit that is used; above one, a limit is broken."""
        pairs = (
            (self.angle, limits.angle),
            (self.velocity, limits.velocity),
            (self.voltage, limits.voltage),
            (self.gear_torque, limits.gear_torque),
        )
        return max(float((used / limit).max()) for used, limit in pairs)


@dataclass(frozen=True, slots=True)
class Planned:
    """One record to be taken."""

    experiment: Experiment
    drive: Drive
    motor_angle: FloatArray | None  # (n_ticks, n_joints) [rad] that is meant; None: not prescribed
    band_hz: tuple[float, float]  # in which the arm is excited
    foreseen: Foreseen
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
    warnings: tuple[Caution, ...]


def limits_of(
    study: Study, angle: str, velocity: str, voltage: str | None, gear_torque: str | None
) -> Limits:
    """The limits as they are written on the command line.

    Parameters
    ----------
    study : Study
        Its servo's limit holds as well.
    angle, velocity : str
        One number, or one a joint with commas between.
    voltage : str, optional
        The servo's limit without.
    gear_torque : str, optional
        None without.

    Returns
    -------
    Limits

    Raises
    ------
    InvalidInput
        One is not a positive number, or there are not as many as joints.
    """
    servo = servo_of(study)
    top = (servo.limit,) * study.n_joints
    given = top if voltage is None else _numbers(voltage, study.n_joints, "--limit-voltage")
    any_torque = (float("inf"),) * study.n_joints
    return Limits(
        angle=_numbers(angle, study.n_joints, "--limit-angle"),
        velocity=_numbers(velocity, study.n_joints, "--limit-velocity"),
        voltage=tuple(min(pair) for pair in zip(given, top, strict=True)),
        gear_torque=any_torque
        if gear_torque is None
        else _numbers(gear_torque, study.n_joints, "--limit-torque"),
    )


def servo_of(study: Study) -> Servo:
    """The servo that the rigid motion is run under.

    Parameters
    ----------
    study : Study

    Returns
    -------
    Servo

    Raises
    ------
    InvalidInput
        The study has none.
    """
    if study.servo is None:
        raise InvalidInput(
            "the study describes no servo, and a motion is not designed without",
            where=str(study.path),
            remedy="add a [servo] table",
        )
    return study.servo


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, count) or not all(0.0 < value < float("inf") for value in values):
        raise InvalidInput(
            f"{text!r} is neither one positive number nor {count} with commas between",
            where=option,
            remedy="give one limit for all joints, or one a joint, such as 1.2,0.9",
        )
    return tuple(values * count if len(values) == 1 else values)
