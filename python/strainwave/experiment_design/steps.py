"""Steps of one joint's reference under all servos: a record to fit and one for validation."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Experiment, FloatArray, Servo, Use
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.experiment_design.motions import predicted_motion, servo_drive, start_of
from strainwave.experiment_design.plan import HELD_CONTROL, LimitBroken, Limits, Planned, clock_of
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


def step_records(
    arm: Arm, values: Values, limits: Limits, band: ExcitationBand, joint: int
) -> tuple[Planned, ...]:
    """Records of steps of one joint's velocity reference: one to fit, one for validation.

    The arm has a servo. Raises LimitBroken if no step of the guessed arm satisfies the limits.
    """
    assert arm.servo is not None
    hold = float(np.clip(_HOLD_PERIODS / band.anti_resonance_hz, _MIN_HOLD, _MAX_HOLD))
    hold = clock_of(arm) * round(hold / clock_of(arm))
    largest = _largest(arm, arm.servo, limits, joint, hold)
    return tuple(
        _record(arm, values, limits, joint, f"{name}-j{joint}", use, hold, levels, size * largest)
        for name, use, levels, size in _PLANS
    )


def _largest(arm: Arm, servo: Servo, limits: Limits, joint: int, hold: float) -> float:
    """Largest step [rad/s, motor side] that no single limit excludes."""
    i = joint - 1
    by_voltage = limits.voltage[i] / servo.kp[i] if servo.kp[i] > 0.0 else np.inf
    turns = np.abs(arm.transmission[:, i])  # of the links per turn of the motor
    moves = turns > 0.0
    by_angle = float(np.min(np.array(limits.angle)[moves] / (turns[moves] * hold)))
    return _STEP_LIMIT_SHARE * min(limits.velocity[i], by_voltage, by_angle)


def _record(
    arm: Arm,
    values: Values,
    limits: Limits,
    joint: int,
    name: str,
    use: Use,
    hold: float,
    levels: tuple[float, ...],
    size: float,
) -> Planned:
    """One record, reduced until the simulated arm satisfies all limits."""
    for _ in range(_MAX_ATTEMPTS):
        drive, angle = _drive(arm, values, limits, joint, size * np.array(levels), hold)
        motion = predicted_motion(arm, values, drive, limits)
        is_unsaturated = (motion.voltage <= _MAX_VOLTAGE_SHARE * np.array(limits.voltage)).all()
        if is_unsaturated and motion.use_of(limits) <= 1.0:
            break
        size *= _REDUCTION_FACTOR
    else:
        raise LimitBroken(
            f"no step of joint {joint} keeps the guessed arm within the limits: even with a small "
            f"step {motion.broken(limits)}",
            where=name,
            remedy="widen the limit if the arm allows it, or check the servo gains",
        )
    purpose = "part of the fit" if use == "tuning" else "validation of the elastic model"
    return Planned(
        experiment=Experiment(
            name, f"{name}.csv", use, (HELD_CONTROL,) * arm.n_joints, joint=joint
        ),
        drive=drive,
        motor_angle=angle,
        band_hz=(1.0 / (len(levels) * hold), 0.5 / drive.tick),
        predicted=motion,
        reasons=(
            f"steps of {size:.3g} rad/s of the motor in both directions, {hold:.3g} s each",
            purpose,
        ),
    )


def _drive(
    arm: Arm, values: Values, limits: Limits, joint: int, levels: FloatArray, hold: float
) -> tuple[Drive, FloatArray]:
    """References of a complete record, and the intended motor angles."""
    tick = clock_of(arm)
    steps = excitation.steps(levels, hold=hold, clock=tick)
    reference = np.zeros((len(steps), arm.n_joints))
    reference[:, joint - 1] = steps
    moved = tick * np.concatenate([np.zeros((1, arm.n_joints)), np.cumsum(reference, axis=0)[:-1]])
    return servo_drive(arm, values, limits, reference), moved + start_of(arm, limits)
