"""What a fit of the whole arm may start from: inertias that the stages before it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.domain.kinds.base import Key
from strainwave.errors import NotIdentifiable

MOTOR_SHARE = 0.3
"""Of a joint's inertia: motors are chosen to match their load, about."""


@dataclass(frozen=True, slots=True)
class StageInertias:
    """Inertias by joint, as each joint's model has them, and what the rigid model has."""

    motor: Mapping[int, float]  # joint, from 1 -> [kg m^2]
    link: Mapping[int, float]
    rigid: Mapping[Key, float | None]  # None: not identified

    def needed(self, name: str) -> float:
        """A parameter of the rigid model that nothing else can stand for.

        `name`: Of the arm as a whole. Raises `NotIdentifiable`: The motion records do not identify
        it.
        """
        value = self.rigid.get((name, None))
        if value is None:
            raise NotIdentifiable(
                f"the whole-arm fit needs {name}, which the motion records do not identify: record"
                ' both joints moving together with use = "motion"'
            )
        return value


def is_positive(value: float | None) -> bool:
    """Whether there is a value, finite and above zero."""
    return value is not None and bool(np.isfinite(value)) and value > 0.0


def required(name: str, value: float) -> float:
    """A value that must be positive for there to be any start at all.

    Returns: The same. Raises `NotIdentifiable`: It is not.
    """
    if not is_positive(value):
        raise NotIdentifiable(
            f"the whole-arm fit has no start: {name} is {value:.3g} by the steps before, which is"
            " impossible. Check the signs, units and assignment of the channels, gear_ratio and"
            " torque_per_volt"
        )
    return value
