"""What is applied to a virtual arm where no log says it: an excitation that fits a use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray, Prbs
from strainwave.domain.parameters import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput

_MOTION_SECONDS = 10.0
_MOTION_TOP_HZ = 1.0
_MOTION_SPEED = 1.8  # [rad/s] of a link
_MOTION_EXCURSION = 1.2  # [rad] of a link
_STEP_SHARE = {"tuning": 0.48, "check": 0.72}  # of the limit that kp times the step takes
_STEP_SECONDS = 0.5


@dataclass(frozen=True, slots=True)
class Plan:
    """One experiment as it is to be run."""

    drive: Drive
    sample_time: float
    samples: int


def invented(
    path: Path,
    arm: Arm,
    experiment: Experiment,
    values: Values,
    rng: np.random.Generator,
    fast_sample: float,
) -> Plan:
    """An excitation that fits the experiment's use.

    `path`: The study's, for messages. `values`: (name, joint) -> value, for what holds the arm up
    at the start. `rng`: Of motions. `fast_sample` [s]: Between samples at most, where the gears'
    vibration is to be seen. Raises `InvalidInput`: It needs a servo that is not there, or moves
    joints in open loop that nothing drives.
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
        tick, excited = period, np.zeros(round(_MOTION_SECONDS / period))
        sample_time = tick
    voltage = np.zeros((len(excited), arm.n_joints))
    reference = np.zeros_like(voltage)
    for i in range(arm.n_joints):
        if experiment.joint == i + 1:
            (voltage if experiment.use in ("frequency", "sweep") else reference)[:, i] = excited
        elif experiment.joint is None and experiment.control[i] == "servo":
            reference[:, i] = _motion(arm, i, tick, rng)
        elif experiment.joint is None:
            raise InvalidInput(
                f"experiment {experiment.name!r} moves joint {i + 1} in open loop, without a log",
                where=str(path),
                remedy='set its control to "servo", or give a log whose input is applied again',
            )
    still = (0.0,) * arm.n_joints
    drive = Drive(
        tick=tick,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=still,
        initial_voltage=arm.holding_voltage(values, still),
    )
    return Plan(drive, sample_time, round(len(excited) * tick / sample_time))


def _motion(arm: Arm, i: int, tick: float, rng: np.random.Generator) -> FloatArray:
    n = arm.joints[i].gear_ratio
    return excitation.smooth_motion(
        duration=_MOTION_SECONDS,
        clock=tick,
        top_hz=_MOTION_TOP_HZ,
        excursion=_MOTION_EXCURSION / n,
        speed=_MOTION_SPEED / n,
        rng=rng,
    )


def _steps(path: Path, arm: Arm, experiment: Experiment) -> FloatArray:
    """There and back: a step of the reference that the servo can follow without its limit."""
    if arm.servo is None:
        raise InvalidInput(
            f"experiment {experiment.name!r} needs a servo",
            where=str(path),
            remedy="add a [servo] table",
        )
    kp = arm.servo.kp[(experiment.joint or 1) - 1]
    level = _STEP_SHARE.get(experiment.use, 0.48) * arm.servo.limit / max(kp, 1e-9)
    levels = np.array([0.0, level, 0.0])
    return excitation.steps(levels, hold=_STEP_SECONDS, clock=arm.servo.period)
