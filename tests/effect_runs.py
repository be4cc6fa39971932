"""Runs of a small virtual arm whose joints have further effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np

from strainwave.domain import ArmModel, EffectName, Log, Study
from strainwave.domain.effects import RecordEffect, all_effects
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import TuningOptions, tune
from tuning_runs import joint_models, rigid_model, shaken_study, truth, written_logs

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
OF_THE_CORE = tuple(e.name for e in all_effects() if not isinstance(e, RecordEffect))
"""Names of the effects that the core simulates."""
ALL: tuple[EffectName, ...] = ("stribeck", "hysteresis", "kinematic-error")
SIZES: Values = {
    ("stribeck_friction", 1): 0.02,
    ("stribeck_velocity", 1): 3.0,
    ("hysteresis_torque", 1): 2.0,
    ("hysteresis_twist", 1): 1.5e-4,
    ("kinematic_error_cos", 1): 1e-4,
    ("kinematic_error_sin", 1): -5e-5,
}
"""Of `ALL`."""
EVERY = SIZES | {
    ("load_friction", 1): 0.15,
    ("power_friction", 1): 0.03,
    ("power_exponent", 1): 0.5,
    ("torque_ripple_cos", 1): 0.01,
    ("torque_ripple_sin", 1): -0.006,
    ("torque_ripple_order", 1): 2.0,
    ("backlash", 1): 4e-5,
    ("ground_stiffness", 1): 8.0,
    ("ground_preload", 1): -2.0,
}


Asked = tuple[EffectName, ...] | Literal["auto"]
"""As in a study."""


def rig(effects: Asked) -> Study:
    """The rig, whose first joint has effects."""
    study = truth()[0]
    return replace(
        study,
        arm=replace(
            study.arm, joints=(replace(study.arm.joints[0], effects=effects), study.arm.joints[1])
        ),
    )


@cache
def records(effects: tuple[EffectName, ...]) -> tuple[Study, Values, tuple[Log, ...]]:
    """Half a second of either joint in open loop, with noise."""
    known = truth()[1] | EVERY
    study, logs = written_logs(shaken_study(rig(effects), 8.0), known, noise=SensorNoise())
    return study, known, logs


@cache
def tuned(has: tuple[EffectName, ...], asked: Asked, most: int = 60) -> ArmModel:
    """From joint models that are 5 % off, knowing nothing of the effects' sizes."""
    study, known, logs = records(has)
    asks = replace(study, arm=replace(study.arm, joints=rig(asked).arm.joints))
    joints = joint_models(asks, known, 0.05, FACTORS)
    return tune(
        logs,
        rigid_model(asks, known, 0.01, 1.0),
        joints,
        Arm.of(asks.arm),
        TuningOptions(max_iterations=most),
    )
