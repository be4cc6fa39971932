"""Records of a small virtual arm with effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np

from strainwave.domain import (
    ArmModel,
    EffectName,
    Experiment,
    Joint,
    Log,
    Prbs,
    Servo,
    Study,
)
from strainwave.domain.arm.effects import RecordEffect, all_effects
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import WholeArmOptions, fit_whole_arm
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs, truth
from virtual_arms import ELASTIC_JOINT

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
    ("kinematic_error_order", 1): 2.0,
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
    ("dead_zone", 1): 0.15,
    ("drive_gain", 1): 0.04,
    ("drive_saturation", 1): 0.0125,  # 10 % at 8 V
    ("drive_limit_loss", 1): 0.6,
    ("drive_limit", 1): 6.0,
    ("drive_lag", 1): 4e-4,
    ("tilt_sin", 1): 1.0,
    ("tilt_cos", 1): -1.5,
    ("flexible_inertia", 1): 0.03,
    ("flexible_frequency", 1): 40.0,
    ("flexible_damping", 1): 0.03,
    ("base_compliance", 1): 4e-6,
    ("base_frequency", 1): 20.0,
    ("base_damping", 1): 0.05,
}
AMPLITUDES = dict.fromkeys(("dead-zone", "drive-gain", "drive-saturation"), (8.0, 4.0, 2.0)) | {
    "drive-limit": (8.0, 7.0, 4.0),
}
"""Of the voltage [V], where an effect takes more than one to be seen."""
SHARES = {"drive-limit": 0.04}
"""Of the residuals that an effect explains at least, where records within its limit fit without it."""
FAR = ("tilt",)
"""Effects that take motion over a wide range of angles to be seen."""
ALIKE = {"ground-spring": ("tilt",)}
"""Effects that the records of an effect, over a small range of angles, do not separate from it."""
WIDE = Experiment(
    "wide", "wide.parquet", "frequency", ("open", "open"), joint=1, prbs=Prbs(5, 0.05, 1, 8.0)
)


Asked = tuple[EffectName, ...] | Literal["auto"]
"""As in a study."""
Shapes = tuple[tuple[tuple[str, int], float], ...]
"""Other values than those of `EVERY`: ((name, joint), value)."""


def rig(effects: Asked) -> Study:
    """The rig with effects at joint 1."""
    study = truth()[0]
    return replace(
        study,
        arm=replace(
            study.arm,
            joints=(
                replace(study.arm.joints[0], effects=effects),
                replace(study.arm.joints[1], effects=()),
            ),
        ),
    )


def shaken(study: Study, amplitudes: tuple[float, ...]) -> Study:
    """Study with a PRBS on each joint at each amplitude [V] as its experiments.

    Each record lasts half a second, or a quarter if there are several amplitudes. A slow PRBS over a
    wide range of angles excites the effects of joint 1.
    """
    experiments = []
    order = 9 if len(amplitudes) == 1 else 8
    for amplitude in amplitudes:
        for one in shaken_study(study, amplitude, order=order).experiments:
            name = one.name if amplitude == amplitudes[0] else f"{one.name}-{amplitude:g}V"
            experiments.append(replace(one, name=name, file=f"{name}.parquet"))
    if any(effect in FAR for effect in study.arm.joints[0].effects):
        experiments.append(WIDE)
    return replace(study, experiments=tuple(experiments))


@cache
def records(
    effects: tuple[EffectName, ...], shapes: Shapes = ()
) -> tuple[Study, Values, tuple[Log, ...]]:
    """Records of each joint in open loop at each amplitude with noise; see `shaken`."""
    known = truth()[1] | EVERY | dict(shapes)
    amplitudes = max((AMPLITUDES.get(name, (8.0,)) for name in effects), key=len, default=(8.0,))
    study, logs = simulated_logs(shaken(rig(effects), amplitudes), known, noise=SensorNoise())
    return study, known, logs


@cache
def whole_arm(
    has: tuple[EffectName, ...],
    asked: Asked,
    most: int = 60,
    shapes: Shapes = (),
    cutoff_hz: float | None = None,
    effort: float = 1.0,
) -> ArmModel:
    """Whole-arm fit from joint models with errors of 5 % and no information on the effects."""
    study, known, logs = records(has, shapes)
    asks = replace(study, arm=replace(study.arm, joints=rig(asked).arm.joints))
    joints = joint_models(asks, known, 0.05, FACTORS)
    return fit_whole_arm(
        logs,
        rigid_model(asks, known, 0.01, 1.0),
        joints,
        Arm.of(asks.arm),
        WholeArmOptions(max_iterations=most, cutoff_hz=cutoff_hz, rival_effort=effort),
    )


def single_joint_study(has: tuple[EffectName, ...]) -> Study:
    """A joint under gravity with a step of its servo and a PRBS."""
    joint = Joint(
        spring="linear",
        gear_ratio=0.01,
        torque_per_volt=0.08,
        encoder_counts=8192,
        accelerometer_distance=0.3,
        accelerometer_hz=300.0,
        effects=has,
    )
    servo = Servo("pi-velocity", period=1e-3, kp=(0.12,), ki=(1.5,), limit=10.0)
    prbs = Prbs(9, 1e-3, 1, 8.0)
    return Study(
        arm=single_joint(joint, gravity=9.81, servo=servo),
        experiments=(
            Experiment("step", "step.parquet", "tuning", ("servo",), joint=1),
            Experiment("prbs", "prbs.parquet", "frequency", ("open",), joint=1, prbs=prbs),
        ),
    )


@cache
def single_tuned(
    has: tuple[EffectName, ...], asked: tuple[EffectName, ...], effort: float = 1.0
) -> ArmModel:
    """Whole-arm fit of a single joint; parameters are known to 5 %, rigid ones to 1 %."""
    known = ELASTIC_JOINT | {("gravity_torque_1", None): 15.0}
    known |= {key: value for key, value in EVERY.items() if key[1] == 1}
    study, logs = simulated_logs(single_joint_study(has), known, noise=SensorNoise())
    asks = replace(study, arm=single_joint_study(asked).arm)
    joints = joint_models(asks, known, 0.05, FACTORS)
    return fit_whole_arm(
        logs,
        rigid_model(asks, known, 0.01, 1.0),
        joints,
        Arm.of(asks.arm),
        WholeArmOptions(rival_effort=effort),
    )
