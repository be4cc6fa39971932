"""An arm, its records and one cause by chance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from strainwave.domain.effects import names
from strainwave.virtual.families import catalogue
from strainwave.virtual.families.causes import Cause, causes_of_the_plant, joint_of, sizes_of
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.families.short_records import with_short_records

_SEEDS = 1_000_000  # even: an arm that is drawn again has the same kind of spring
_SERIES = 7000  # of the catalogue, from here on
_FEWEST_COUNTS = 2000
_SHORTEST_SAMPLE = 5e-4  # [s]
_UPRIGHT = 1.0 / 3.0  # of the arms


@dataclass(frozen=True, slots=True)
class Run:
    """A drawn arm with a cause; `number` counts the runs of one cause."""

    rig: Rig
    cause: Cause
    number: int


def causes(engine: str) -> tuple[str, ...]:
    """What an engine can give an arm: "own" or "mujoco"."""
    if engine == "mujoco":
        from benchmarks.studies.causes.in_mujoco import CAUSES

        return CAUSES
    return causes_of_the_plant()


def drawn(name: str, number: int, series: int = 0) -> Run:
    """The arm and the sizes of one run.

    Parameters
    ----------
    name : str
        Of the cause.
    number : int
        Among the runs of that cause.
    series : int
        Another one draws all anew.

    Returns
    -------
    Run
    """
    of_cause = crc32(name.encode())
    rig = _with_a_fair_encoder(of_cause % _SEEDS + number, series)
    rig = replace(rig, sample_time=max(rig.sample_time, _SHORTEST_SAMPLE))
    rng = np.random.default_rng([series, of_cause, number])
    rig = with_short_records(rig, upright=bool(rng.uniform() < _UPRIGHT), rng=rng)
    joint = int(rng.integers(1, rig.study.arm.n_joints + 1))
    joint = joint_of(name, rig.study.arm, joint)
    return Run(rig, Cause(name, joint, sizes_of(name, joint, rig, rng)), number)


def _with_a_fair_encoder(seed: int, series: int) -> Rig:
    """An arm of the catalogue whose short records show its friction."""
    while True:
        rig = catalogue.drawn(seed, _SERIES + series)
        if min(joint.encoder_counts or 0.0 for joint in rig.study.arm.joints) >= _FEWEST_COUNTS:
            return rig
        seed += _SEEDS


def can_be_named(name: str) -> bool:
    """Whether a study can name a cause among its effects."""
    return name in names()
