"""Shortest records that identification needs: 10 to 20 s of an arm, 4 to 6 s of one core."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Control, Prbs
from strainwave.domain.keys import Values
from strainwave.domain.kinds.base import in_plane_gravity
from strainwave.dynamics.arm import Arm
from strainwave.virtual.families.rigs import Rig, rig_experiments
from strainwave.virtual.plans import Plan, default_plan

_MOTION_DURATION = 6.0  # [s]
_STANDARD_GRAVITY = 9.81  # [m/s^2]
_MAX_GRAVITY_SHARE = 0.35  # of the largest torque of a drive
_VOLTAGE, _UPRIGHT_VOLTAGE = 10.0, 5.0  # [V]; the servo of an upright arm needs the rest


def plans(rig: Rig, seed: int) -> list[Plan]:
    """One plan per experiment of `with_short_records`. `seed` is that of the motions."""
    arm = Arm.of(rig.study.arm)
    plans = []
    for number, experiment in enumerate(rig.study.experiments):
        rng = np.random.default_rng([seed, number])
        plan = default_plan(rig.study.path, arm, experiment, rig.values, rng, rig.sample_time)
        if experiment.use == "motion":
            plan = _shorten(plan, _MOTION_DURATION)
        plans.append(plan)
    return plans


def _shorten(plan: Plan, seconds: float) -> Plan:
    ticks = round(seconds / plan.drive.tick)
    drive = replace(
        plan.drive, voltage=plan.drive.voltage[:ticks], reference=plan.drive.reference[:ticks]
    )
    return replace(plan, drive=drive, samples=round(seconds / plan.sample_time))


def with_short_records(rig: Rig, *, upright: bool, rng: np.random.Generator) -> Rig:
    """Rig with few short records, under servos and a gravity that they can hold if it is upright.

    The records are a motion of 6 s and, for each joint, a PRBS of two periods of 511 clocks, a
    sweep at lower amplitude for three-slope springs, and a step.
    """
    arm, values = rig.study.arm, rig.values
    servo = arm.servo
    if upright and servo is not None:
        length = arm.joints[1].origin.xyz[0]
        first = values["alpha", None] / length * rng.uniform(0.8, 1.2)
        second = values["gamma", None] / length
        limits = [
            _MAX_GRAVITY_SHARE * j.torque_per_command * servo.limit / j.gear_ratio
            for j in arm.joints
        ]
        gravity = min(_STANDARD_GRAVITY, limits[0] / (first + second), limits[1] / second)
        arm = replace(arm, gravity=in_plane_gravity(float(gravity)))
        torques: Values = {("gravity_torque_1", None): gravity * first}
        values = values | torques | {("gravity_torque_2", None): gravity * second}
    prbs = Prbs(9, servo.period if servo else 1e-3, 2, _VOLTAGE)
    control: tuple[Control, Control] = ("open", "open")
    if upright:
        control, prbs = ("servo", "servo"), replace(prbs, amplitude=_UPRIGHT_VOLTAGE)
    experiments = rig_experiments(arm.joints[0].spring, prbs, control)
    study = replace(rig.study, arm=arm, experiments=experiments)
    classes = rig.classes | {"gravity": "upright" if upright else "horizontal"}
    return replace(rig, study=study, values=values, classes=classes)
