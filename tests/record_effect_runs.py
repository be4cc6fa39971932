"""Runs of a small virtual arm that changes from record to record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from effect_runs import FACTORS, rig
from strainwave.domain import ArmModel, EffectName, Log, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import TuningOptions, tune
from tuning_runs import joint_models, rigid_model, shaken_study, truth, written_logs

AMPLITUDES = (8.0, 6.0, 9.0)
"""[V] of the records of each joint."""
CHANGES = (0.15, -0.05, -0.2)
"""Relative ones of what changes, from one amplitude to the next."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Records of an arm, and what is true of it."""

    study: Study
    known: Values
    logs: tuple[Log, ...]

    @property
    def names(self) -> list[str]:
        """Of the records."""
        return [log.name for log in self.logs]


@cache
def runs(changed: tuple[str, int] | None = None) -> Runs:
    """Half a second of either joint at each amplitude, with noise and one parameter that changes."""
    known = truth()[1]
    logs: list[Log] = []
    for k, (amplitude, change) in enumerate(zip(AMPLITUDES, CHANGES, strict=True), start=1):
        study = shaken_study(rig(()), amplitude)
        named = [(e, f"{e.name}-{k}") for e in study.experiments]
        experiments = tuple(replace(e, name=name, file=f"{name}.parquet") for e, name in named)
        own = dict(known)
        if changed is not None:
            own[changed] *= 1.0 + change
        wanted = replace(study, experiments=experiments)
        written, found = written_logs(wanted, own, seed=k, noise=SensorNoise())
        logs += found
    return Runs(written, known, tuple(logs))


def fitted(runs: Runs, *asked: tuple[EffectName, ...]) -> ArmModel:
    """From joint models that are 5 % off, with effects that each joint is asked for."""
    arm = runs.study.arm
    named = (*asked, *[()] * (arm.n_joints - len(asked)))
    pairs = zip(arm.joints, named, strict=True)
    arm = replace(arm, joints=tuple(replace(joint, effects=own) for joint, own in pairs))
    asks = replace(runs.study, arm=arm)
    joints = joint_models(asks, runs.known, 0.05, FACTORS)
    rigid = rigid_model(asks, runs.known, 0.01, 1.0)
    return tune(runs.logs, rigid, joints, Arm.of(arm), TuningOptions(max_iterations=60))
