"""Records as short as identify can do with: 10 to 20 s of an arm, 4 to 6 s of one core."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Control, Experiment, Prbs, Spring, Use
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.plans import Plan, invented

_MOTION_SECONDS = 6.0
_GRAVITY = 9.81  # [m/s^2]
_HELD = 0.35  # of a drive's largest torque that gravity may take
_UPRIGHT_SHARE = 0.5  # of the voltage that shakes an upright arm, the rest being its servo's
_SWEEP_SHARE = 0.4


def plans(rig: Rig, seed: int) -> list[Plan]:
    """What is applied in each experiment.

    `rig`: With the experiments of `with_short_records`. `seed`: Of motions. Returns: One per
    experiment.
    """
    arm = Arm.of(rig.study.arm)
    found = []
    for number, experiment in enumerate(rig.study.experiments):
        rng = np.random.default_rng([seed, number])
        plan = invented(rig.study.path, arm, experiment, rig.values, rng, rig.sample_time)
        if experiment.use == "motion":
            plan = _shortened(plan, _MOTION_SECONDS)
        found.append(plan)
    return found


def _shortened(plan: Plan, seconds: float) -> Plan:
    ticks = round(seconds / plan.drive.tick)
    drive = replace(
        plan.drive, voltage=plan.drive.voltage[:ticks], reference=plan.drive.reference[:ticks]
    )
    return replace(plan, drive=drive, samples=round(seconds / plan.sample_time))


def with_short_records(rig: Rig, *, upright: bool, rng: np.random.Generator) -> Rig:
    """Few records; servos hold what stands upright, under a gravity that they can hold.

    `upright`: Whether gravity acts in the plane of motion. `rng`: Of where the first link's weight
    acts. Returns: A motion of 6 s; per joint a binary sequence of two periods of 511 clocks, a
    smaller one for a curve, and a step.
    """
    arm, values = rig.study.arm, rig.values
    servo = arm.servo
    if upright and servo is not None and arm.link_length is not None:
        first = values["alpha", None] / arm.link_length * rng.uniform(0.8, 1.2)
        second = values["gamma", None] / arm.link_length
        held = [_HELD * (j.torque_per_volt or 1.0) * servo.limit / j.gear_ratio for j in arm.joints]
        gravity = min(_GRAVITY, held[0] / (first + second), held[1] / second)
        arm = replace(arm, gravity=float(gravity))
        torques: Values = {("gravity_torque_1", None): gravity * first}
        values = values | torques | {("gravity_torque_2", None): gravity * second}
    clock = servo.period if servo else 1e-3
    experiments = _experiments(arm.joints[0].spring, clock, upright=upright)
    study = replace(rig.study, arm=arm, experiments=experiments)
    classes = rig.classes | {"gravity": "upright" if upright else "horizontal"}
    return replace(rig, study=study, values=values, classes=classes)


def _experiments(spring: Spring, clock: float, *, upright: bool) -> tuple[Experiment, ...]:
    both: tuple[Control, Control] = ("servo", "servo")
    control: tuple[Control, Control] = both if upright else ("open", "open")
    volt = 10.0 * (_UPRIGHT_SHARE if upright else 1.0)
    found = [Experiment("motion", "motion.csv", "motion", both)]

    def shaken(name: str, use: Use, joint: int, volt: float) -> None:
        prbs = Prbs(9, clock, 2, volt)
        name = f"{name}-j{joint}"
        found.append(Experiment(name, f"{name}.csv", use, control, joint=joint, prbs=prbs))

    for j in (1, 2):
        shaken("prbs", "frequency", j, volt)
        if spring == "three-slope":
            shaken("sweep", "sweep", j, _SWEEP_SHARE * volt)
        found.append(Experiment(f"step-j{j}", f"step-j{j}.csv", "tuning", both, joint=j))
    return tuple(found)
