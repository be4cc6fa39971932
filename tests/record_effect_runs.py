"""Records of a small virtual arm in several postures, with changes between records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from effect_runs import FACTORS, rig
from strainwave.domain import ArmModel, EffectName, Log, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory, simulate
from strainwave.identification.whole_arm import WholeArmOptions, fit_whole_arm
from strainwave.virtual import scara
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs, truth

AMPLITUDES = (8.0, 6.0, 9.0)
"""[V] of the records of each joint."""
POSTURES = ((0.0, 0.6), (0.3, -0.9), (-0.4, 1.4))
"""[rad] of the links, where those of each amplitude begin."""
CHANGES = (0.15, -0.05, -0.2)
"""Relative ones of what changes, from one amplitude to the next."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Records of an arm and its true values."""

    study: Study
    known: Values
    logs: tuple[Log, ...]

    @property
    def names(self) -> list[str]:
        """Names of the records."""
        return [log.name for log in self.logs]

    def amplified(self, joint: int, gains: Sequence[float]) -> Runs:
        """Records of a drive with another gain."""
        pairs = zip(self.logs, gains, strict=True)
        logs = [
            replace(log, channels={**log.channels, u: log.channels[u] / (1.0 + gain)})
            for (log, gain), u in zip(pairs, [f"u{joint}"] * len(gains), strict=True)
        ]
        return replace(self, logs=tuple(logs))

    def beside(self, channels: Mapping[str, float]) -> Runs:
        """Records with an addition to some channels."""
        logs = []
        for log in self.logs:
            moved = {name: log.channels[name] + more for name, more in channels.items()}
            logs.append(replace(log, channels={**log.channels, **moved}))
        return replace(self, logs=tuple(logs))


@dataclass(frozen=True, slots=True)
class From:
    """Simulator that starts in a posture held by constant voltages."""

    posture: tuple[float, ...]  # [rad]

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        motor = tuple((np.array(self.posture) / arm.gear_ratios).tolist())
        holding = arm.holding_voltage(values, motor)
        begun = replace(
            drive, motor_angle=motor, voltage=drive.voltage + holding, initial_voltage=holding
        )
        return simulate(arm, values, begun, sample_time=sample_time, samples=samples, record=record)


@cache
def runs(changed: Key | None = None, *, vertical: bool = False) -> Runs:
    """Records of each joint in each posture, with noise and one changing parameter.

    Each record lasts a quarter of a second, or half a second under gravity, whose parameters need
    more motion.
    """
    base, known = rig(()), truth()[1]
    if vertical:
        base = replace(base, arm=change_arm_keys(base.arm, gravity=9.81))
        second = 9.81 * known["gamma", None] / scara.STIFF.link_length[0]
        known |= {("gravity_torque_1", None): 60.0, ("gravity_torque_2", None): second}
    logs: list[Log] = []
    each = zip(AMPLITUDES, POSTURES, CHANGES, strict=True)
    for k, (amplitude, posture, change) in enumerate(each, start=1):
        study = shaken_study(base, amplitude, order=9 if vertical else 8)
        named = [(e, f"{e.name}-{k}") for e in study.experiments]
        experiments = tuple(replace(e, name=name, file=f"{name}.parquet") for e, name in named)
        own = dict(known)
        if changed is not None:
            own[changed] *= 1.0 + change
        wanted = replace(study, experiments=experiments)
        written, found = simulated_logs(
            wanted, own, seed=k, noise=SensorNoise(), simulator=From(posture)
        )
        logs += found
    return Runs(written, known, tuple(logs))


def fitted(runs: Runs, *asked: tuple[EffectName, ...]) -> ArmModel:
    """Whole-arm fit with effects, from joint models with errors of 5 %, with few rival fits."""
    arm = runs.study.arm
    named = (*asked, *[()] * (arm.n_joints - len(asked)))
    pairs = zip(arm.joints, named, strict=True)
    arm = replace(arm, joints=tuple(replace(joint, effects=own) for joint, own in pairs))
    asks = replace(runs.study, arm=arm)
    joints = joint_models(asks, runs.known, 0.05, FACTORS)
    rigid = rigid_model(asks, runs.known, 0.01, 1.0)
    options = WholeArmOptions(max_iterations=60, rival_effort=0.3)
    return fit_whole_arm(runs.logs, rigid, joints, Arm.of(arm), options)
