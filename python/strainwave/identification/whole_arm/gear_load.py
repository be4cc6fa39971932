"""What the gears carry in the records, by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, TorqueHistogram
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.numerics.parallel import side_by_side

_BINS = 60


def gear_torques(
    records: Sequence[Dataset], values: dict[tuple[str, int | None], float]
) -> FloatArray:
    """The largest torque that each gear carries, but for one sample in a thousand.

    `values`: (name, joint) -> value.

    Returns: (n_joints,) [N m].
    """
    return largest_of(gear_torque_samples(records, values))


def gear_torque_samples(
    records: Sequence[Dataset], values: dict[tuple[str, int | None], float]
) -> list[FloatArray]:
    """What each gear carries in each record.

    `values`: (name, joint) -> value.

    Returns: (n_samples, n_joints) [N m]: Moduli.
    """

    def of_record(record: Dataset) -> FloatArray:
        return np.abs(record.run(values, record.start(), ["gear_torque"])["gear_torque"])

    return side_by_side([partial(of_record, r) for r in records])


def largest_of(gear_loads: Sequence[FloatArray]) -> FloatArray:
    """The largest of each gear, but for one sample in a thousand of a record: (n_joints,) [N m]."""
    return np.asarray(np.max([np.quantile(torque, 0.999, axis=0) for torque in gear_loads], axis=0))


def histograms_of(gear_loads: Sequence[FloatArray]) -> tuple[TorqueHistogram, ...]:
    """How often each gear carries which torque, over all records.

    `gear_loads` (n_samples, n_joints) [N m].
    """
    together = np.concatenate(gear_loads)
    found = []
    for joint, torque in enumerate(together.T, start=1):
        count, edges = np.histogram(torque, bins=_BINS, range=(0.0, float(torque.max())))
        found.append(TorqueHistogram(joint, edges, count / len(torque)))
    return tuple(found)
