"""Largest gear torques and voltages of the joints in the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain.keys import Key
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.gear_torques import gear_torques
from strainwave.signals.prepared_record import prepare_record


@dataclass(frozen=True, slots=True)
class Loads:
    """Largest absolute values over all records, one entry per joint."""

    torque: Sequence[float]  # [N m] of the gear, 99.9 % quantile
    voltage: Sequence[float]  # [V] of the drive


def loads_of(records: Sequence[Dataset], values: Mapping[Key, float]) -> Loads:
    """Largest gear torque and voltage of each joint over all records.

    `values` maps (name, joint) to the parameter values of the gear torque simulation.
    """
    largest_voltages = [
        np.abs(prepare_record(record.log, record.arm).voltage).max(axis=0) for record in records
    ]
    return Loads(
        gear_torques(records, dict(values)).tolist(), np.max(largest_voltages, axis=0).tolist()
    )
