"""Steps of one joint's reference under all servos: a record to fit and one for validation."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Experiment, FloatArray, Use
from strainwave.dynamics import excitation
from strainwave.experiment_design.motions import predicted_motion, servo_drive
from strainwave.experiment_design.plan import (
    HELD_CONTROL,
    GuessedArm,
    LimitBroken,
    Planned,
    clock_of,
)
from strainwave.experiment_design.voltages import ExcitationBand

_HOLD_PERIODS = 6.0  # of the anti-resonance per level, in which the vibration decays
_MIN_HOLD, _MAX_HOLD = 0.2, 2.0  # [s] per level
_STEP_LIMIT_SHARE = 0.9  # of each limit for the step; the rest is for overshoot
_MAX_VOLTAGE_SHARE = 0.98  # of the voltage limit; a saturated servo does not control
_REDUCTION_FACTOR = 0.9  # per attempt, if the simulated arm violates a limit
_MAX_ATTEMPTS = 20  # reduce the steps to 1/8
_PLANS: tuple[tuple[str, Use, tuple[float, ...], float], ...] = (
    # name, use, levels, size: validation starts in the other direction, with smaller steps
    ("step", "tuning", (0.0, 1.0, 0.0, -1.0, 0.0), 1.0),
    ("step-check", "check", (0.0, -1.0, 0.0, 1.0, 0.0), 0.7),
)


def step_records(guess: GuessedArm, band: ExcitationBand, joint: int) -> tuple[Planned, ...]:
    """Records of steps of one joint's velocity reference: one to fit, one for validation.

    The arm has a servo. Raises LimitBroken if no step of the guessed arm satisfies the limits.
    """
    arm, limits = guess.arm, guess.limits
    assert arm.servo is not None
    hold = float(np.clip(_HOLD_PERIODS / band.anti_resonance_hz, _MIN_HOLD, _MAX_HOLD))
    hold = clock_of(arm) * round(hold / clock_of(arm))
    i = joint - 1
    by_voltage = limits.voltage[i] / arm.servo.kp[i] if arm.servo.kp[i] > 0.0 else np.inf
    turns = np.abs(arm.transmission[:, i])  # of the links per turn of the motor
    moves = turns > 0.0
    by_angle = float(np.min(np.array(limits.angle)[moves] / (turns[moves] * hold)))
    largest = _STEP_LIMIT_SHARE * min(limits.velocity[i], by_voltage, by_angle)
    return tuple(
        _record(guess, joint, f"{name}-j{joint}", use, hold, size * largest * np.array(levels))
        for name, use, levels, size in _PLANS
    )


def _record(
    guess: GuessedArm, joint: int, name: str, use: Use, hold: float, levels: FloatArray
) -> Planned:
    """One record, reduced until the simulated arm satisfies all limits."""
    limits, tick, n_joints = guess.limits, clock_of(guess.arm), guess.arm.n_joints
    for _ in range(_MAX_ATTEMPTS):
        steps = excitation.steps(levels, hold=hold, clock=tick)
        reference = np.zeros((len(steps), n_joints))
        reference[:, joint - 1] = steps
        drive = servo_drive(guess, reference)
        motion = predicted_motion(guess, drive)
        is_unsaturated = (motion.voltage <= _MAX_VOLTAGE_SHARE * np.array(limits.voltage)).all()
        if is_unsaturated and motion.use_of(limits) <= 1.0:
            break
        levels = _REDUCTION_FACTOR * levels
    else:
        raise LimitBroken(
            f"no step of joint {joint} keeps the guessed arm within the limits: even with a small "
            f"step {motion.broken(limits)}",
            where=name,
            remedy="widen the limit if the arm allows it, or check the servo gains",
        )
    moved = tick * np.concatenate([np.zeros((1, n_joints)), np.cumsum(reference, axis=0)[:-1]])
    purpose = "part of the fit" if use == "tuning" else "validation of the elastic model"
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD_CONTROL,) * n_joints, joint=joint),
        drive=drive,
        motor_angle=moved + guess.start,
        band_hz=(1.0 / (len(levels) * hold), 0.5 / drive.tick),
        predicted=motion,
        reasons=(
            f"steps of {levels.max():.3g} rad/s of the motor in both directions, {hold:.3g} s each",
            purpose,
        ),
    )
