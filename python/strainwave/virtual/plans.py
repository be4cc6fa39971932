"""Default excitation of an experiment of a virtual arm by its use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray, Prbs
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput

MOTION_DURATION = 10.0  # [s]
_MAX_MOTION_HZ = 1.0  # 1/10 of the lowest anti-resonance of the built-in rig
_MAX_LINK_SPEED = 1.8  # [rad/s] of a motion
_MAX_LINK_EXCURSION = 1.2  # [rad] of a motion
_STEP_VOLTAGE_SHARES = {"tuning": 0.48, "check": 0.72}  # kp times the step over the limit
STEP_HOLD = 0.5  # [s] per level


@dataclass(frozen=True, slots=True)
class Plan:
    """One experiment to simulate."""

    drive: Drive
    sample_time: float  # [s]
    samples: int


def default_plan(
    path: Path,
    arm: Arm,
    experiment: Experiment,
    values: Values,
    rng: np.random.Generator,
    fast_sample: float,
) -> Plan:
    """Excitation of an experiment by its use.

    `path` is the study's, for messages; `values` give the voltage that holds the arm at the start.
    `fast_sample` [s] is the largest sample time of records that resolve the vibration of the gears.
    Raises InvalidInput if the experiment needs a missing servo, or if it would move joints in open
    loop without an input.
    """
    period = arm.servo.period if arm.servo else 1e-3
    if experiment.use in ("frequency", "sweep"):
        prbs = experiment.prbs or Prbs(10, 1e-3, 4, arm.servo.limit if arm.servo else 10.0)
        tick, excited = prbs.clock, excitation.prbs(prbs)
        sample_time = min(fast_sample, tick)
    elif experiment.joint is not None:
        tick, excited = period, _steps(path, arm, experiment)
        sample_time = min(fast_sample, tick)
    else:
        tick, excited = period, np.zeros(round(MOTION_DURATION / period))
        sample_time = tick
    voltage = np.zeros((len(excited), arm.n_joints))
    reference = np.zeros_like(voltage)
    for i in range(arm.n_joints):
        if experiment.joint == i + 1:
            (voltage if experiment.use in ("frequency", "sweep") else reference)[:, i] = excited
        elif experiment.joint is None and experiment.control[i] == "servo":
            reference[:, i] = smooth_reference(arm.joints[i].gear_ratio, tick, rng)
        elif experiment.joint is None:
            raise InvalidInput(
                f"experiment {experiment.name!r} moves joint {i + 1} in open loop and has no log",
                where=str(path),
                remedy='set its control to "servo", or provide a log with the input to apply',
            )
    start = (0.0,) * arm.n_joints
    drive = Drive(
        tick=tick,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=start,
        initial_voltage=arm.holding_voltage(values, start),
    )
    return Plan(drive, sample_time, round(len(excited) * tick / sample_time))


def smooth_reference(gear_ratio: float, tick: float, rng: np.random.Generator) -> FloatArray:
    """Velocity reference [rad/s, motor side] of a rigid-motion record, one value per tick."""
    return excitation.smooth_motion(
        duration=MOTION_DURATION,
        clock=tick,
        top_hz=_MAX_MOTION_HZ,
        excursion=_MAX_LINK_EXCURSION / abs(gear_ratio),
        speed=_MAX_LINK_SPEED / abs(gear_ratio),
        rng=rng,
    )


def _steps(path: Path, arm: Arm, experiment: Experiment) -> FloatArray:
    """A step of the reference and back that does not saturate the servo."""
    if arm.servo is None:
        raise InvalidInput(
            f"experiment {experiment.name!r} needs a servo",
            where=str(path),
            remedy="add a [servo] table",
        )
    kp = arm.servo.kp[(experiment.joint or 1) - 1]
    level = (
        _STEP_VOLTAGE_SHARES.get(experiment.use, _STEP_VOLTAGE_SHARES["tuning"])
        * arm.servo.limit
        / max(kp, 1e-9)
    )
    levels = np.array([0.0, level, 0.0])
    return excitation.steps(levels, hold=STEP_HOLD, clock=arm.servo.period)
