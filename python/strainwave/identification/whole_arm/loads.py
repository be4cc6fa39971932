"""The largest that the joints bear, and are driven by, in the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.gear_load import gear_torques
from strainwave.signals.recorded_input import driving_voltages


@dataclass(frozen=True, slots=True)
class Loads:
    """Of each joint."""

    torque: Sequence[float]  # [N m] that its gear carries, but for one sample in a thousand
    voltage: Sequence[float]  # [V] that drives it


def loads_of(records: Sequence[Dataset], values: Mapping[tuple[str, int | None], float]) -> Loads:
    """The largest of all records.

    `values`: (name, joint) -> value, by which gear torques are simulated.
    """
    voltages = [np.abs(driving_voltages(one.arm, one.log)).max(axis=0) for one in records]
    return Loads(gear_torques(records, dict(values)).tolist(), np.max(voltages, axis=0).tolist())
