"""Steps of one joint's reference under all servos: one record to fit, one to check with."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Experiment, FloatArray, Servo, Use
from strainwave.domain.parameters import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.experiment_design.band import Band
from strainwave.experiment_design.plan import HELD, LimitBroken, Limits, Planned, clock_of
from strainwave.experiment_design.predicted_motion import predicted_motion, run

_PERIODS = 6.0  # of the anti-resonance in each level: what a step sets off dies out meanwhile
_LEAST_HOLD, _LONGEST_HOLD = 0.2, 2.0  # [s]
_ROOM = 0.9  # of each limit that the step itself takes; overshoot needs the rest
_SATURATED = 0.98  # of the voltage limit: a servo that reaches it no longer acts
_SMALLER = 0.9
_TRIES = 20
_PLANS: tuple[tuple[str, Use, tuple[float, ...], float], ...] = (
    # name, use, levels, size: the check goes the other way first, and less far
    ("step", "tuning", (0.0, 1.0, 0.0, -1.0, 0.0), 1.0),
    ("step-check", "check", (0.0, -1.0, 0.0, 1.0, 0.0), 0.7),
)


def step_records(
    arm: Arm, values: Values, limits: Limits, band: Band, joint: int
) -> tuple[Planned, ...]:
    """Steps of one joint's velocity reference, to be fitted, and others to check the model with.

    `arm`: With a servo. `values`: (name, joint) -> value of the guessed arm. `band`: Of this joint.
    `joint`: From 1. Returns: Two. Raises `LimitBroken`: No step of the guessed arm keeps to the
    limits.
    """
    assert arm.servo is not None
    hold = float(np.clip(_PERIODS / band.anti_resonance_hz, _LEAST_HOLD, _LONGEST_HOLD))
    hold = clock_of(arm) * round(hold / clock_of(arm))
    largest = _largest(arm, arm.servo, limits, joint, hold)
    return tuple(
        _record(arm, values, limits, joint, f"{name}-j{joint}", use, hold, levels, size * largest)
        for name, use, levels, size in _PLANS
    )


def _largest(arm: Arm, servo: Servo, limits: Limits, joint: int, hold: float) -> float:
    """The largest step that no limit forbids by itself [rad/s at the motor]."""
    i = joint - 1
    ratio = abs(arm.joints[i].gear_ratio)
    by_voltage = limits.voltage[i] / servo.kp[i] if servo.kp[i] > 0.0 else np.inf
    return _ROOM * min(limits.velocity[i], by_voltage, limits.angle[i] / (ratio * hold))


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
    """One record, made smaller until the simulated arm keeps to all limits."""
    for _ in range(_TRIES):
        drive, angle = _drive(arm, values, joint, size * np.array(levels), hold)
        seen = predicted_motion(run(arm, values, drive, drive.tick))
        unsaturated = (seen.voltage <= _SATURATED * np.array(limits.voltage)).all()
        if unsaturated and seen.use_of(limits) <= 1.0:
            break
        size *= _SMALLER
    else:
        raise LimitBroken(
            f"no step of joint {joint} keeps the guessed arm within the limits: even of a small "
            f"one {seen.broken(limits)}",
            where=name,
            remedy="give a wider limit if the arm bears it, or check the servo's gains",
        )
    what = (
        "fitted with the rest" if use == "tuning" else "never fitted: it checks the elastic model"
    )
    return Planned(
        experiment=Experiment(name, f"{name}.csv", use, (HELD,) * arm.n_joints, joint=joint),
        drive=drive,
        motor_angle=angle,
        band_hz=(1.0 / (len(levels) * hold), 0.5 / drive.tick),
        predicted=seen,
        reasons=(
            f"steps of {size:.3g} rad/s at the motor, there and back, both ways, {hold:.3g} s each",
            what,
        ),
    )


def _drive(
    arm: Arm, values: Values, joint: int, levels: FloatArray, hold: float
) -> tuple[Drive, FloatArray]:
    """References of a whole record, and the motor angles meant."""
    tick = clock_of(arm)
    stepped = excitation.steps(levels, hold=hold, clock=tick)
    reference = np.zeros((len(stepped), arm.n_joints))
    reference[:, joint - 1] = stepped
    angle = tick * np.concatenate([np.zeros((1, arm.n_joints)), np.cumsum(reference, axis=0)[:-1]])
    start = (0.0,) * arm.n_joints
    drive = Drive(
        tick=tick,
        voltage=np.zeros_like(reference),
        reference=reference,
        servo=(True,) * arm.n_joints,
        motor_angle=start,
        initial_voltage=arm.holding_voltage(values, start),
    )
    return drive, angle
