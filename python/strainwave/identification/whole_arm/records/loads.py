"""Loads of the joints in the records: torques of the gears, by simulation, and voltages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, TorqueHistogram
from strainwave.domain.keys import Key
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.prepared_record import prepare_record

HISTOGRAM_BINS = 60


def gear_torques(records: Sequence[Dataset], values: dict[Key, float]) -> FloatArray:
    """Largest torque of each gear (n_joints,) [N m], at the 99.9 % quantile of a record."""
    return largest_of(gear_torque_samples(records, values))


def gear_torque_samples(records: Sequence[Dataset], values: dict[Key, float]) -> list[FloatArray]:
    """Absolute torque of each gear in each record: arrays (n_samples, n_joints) [N m]."""

    def of_record(record: Dataset) -> FloatArray:
        return np.abs(record.run(values, record.start(), ["gear_torque"])["gear_torque"])

    return run_parallel([partial(of_record, r) for r in records])


@dataclass(frozen=True, slots=True)
class Loads:
    """Largest absolute values over all records, one entry per joint."""

    torque: Sequence[float]  # [N m] of the gear, 99.9 % quantile
    voltage: Sequence[float]  # [V] of the drive


def loads_of(records: Sequence[Dataset], values: dict[Key, float]) -> Loads:
    """Largest gear torque and voltage of each joint over all records."""
    voltages = [np.abs(prepare_record(r.log, r.arm).voltage).max(axis=0) for r in records]
    return Loads(gear_torques(records, values).tolist(), np.max(voltages, axis=0).tolist())


def largest_of(gear_loads: Sequence[FloatArray]) -> FloatArray:
    """The largest of each gear, but for one sample in a thousand of a record: (n_joints,) [N m]."""
    return np.asarray(np.max([np.quantile(torque, 0.999, axis=0) for torque in gear_loads], axis=0))


def histograms_of(gear_loads: Sequence[FloatArray]) -> tuple[TorqueHistogram, ...]:
    """Share of samples by torque of each gear, over all records."""
    together = np.concatenate(gear_loads)
    histograms = []
    for joint, torque in enumerate(together.T, start=1):
        count, edges = np.histogram(torque, bins=HISTOGRAM_BINS, range=(0.0, float(torque.max())))
        histograms.append(TorqueHistogram(joint, edges, count / len(torque)))
    return tuple(histograms)
