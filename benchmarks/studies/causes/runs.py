"""Draw an arm, its records and one cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from benchmarks.families import catalogue
from benchmarks.families.catalogue import with_short_records
from benchmarks.families.causes import Cause, cause_names, joint_of, sizes_of
from benchmarks.families.rigs import Rig
from strainwave.domain.arm.effects import names

_SEEDS = 1_000_000  # even, so that an arm that is drawn again has the same kind of spring
_SERIES = 7000  # first series of the catalogue
_MIN_COUNTS = 2000  # per motor turn
_MIN_SAMPLE_TIME = 5e-4  # [s]
_VERTICAL_SHARE = 1.0 / 3.0  # of the arms


@dataclass(frozen=True, slots=True)
class Run:
    """A drawn arm with a cause; `number` counts the runs of one cause."""

    rig: Rig
    cause: Cause
    number: int


def causes(engine: str) -> tuple[str, ...]:
    """Causes that an engine, "own" or "mujoco", can simulate."""
    if engine == "mujoco":
        from benchmarks.studies.causes.in_mujoco import CAUSES

        return CAUSES
    return cause_names()


def draw_run(name: str, number: int, series: int = 0) -> Run:
    """Draw the arm and the sizes of a cause's run; another series draws other arms."""
    cause_seed = crc32(name.encode())
    rig = _draw_rig(cause_seed % _SEEDS + number, series)
    rig = replace(rig, sample_time=max(rig.sample_time, _MIN_SAMPLE_TIME))
    rng = np.random.default_rng([series, cause_seed, number])
    rig = with_short_records(rig, upright=bool(rng.uniform() < _VERTICAL_SHARE), rng=rng)
    joint = int(rng.integers(1, rig.study.arm.n_joints + 1))
    joint = joint_of(name, rig.study.arm, joint)
    return Run(rig, Cause(name, joint, sizes_of(name, joint, rig, rng)), number)


def _draw_rig(seed: int, series: int) -> Rig:
    """Draw a catalogue arm whose encoders resolve friction in short records."""
    while True:
        rig = catalogue.drawn(seed, _SERIES + series)
        if min(joint.encoder_counts or 0.0 for joint in rig.study.arm.joints) >= _MIN_COUNTS:
            return rig
        seed += _SEEDS


def can_be_named(name: str) -> bool:
    """Whether a study can name the cause as an effect."""
    return name in names()
