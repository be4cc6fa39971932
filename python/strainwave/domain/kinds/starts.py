"""Estimates of earlier stages from which the whole-arm fit starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.domain.keys import Key, Row
from strainwave.errors import NotIdentifiable

MOTOR_SHARE = 0.5
"""Motor's share of a joint's total inertia where only the total is known.

Designs match motor and link within a small factor.
"""


@dataclass(frozen=True, slots=True)
class StageInertias:
    """Inertias of motor and link from each joint model, and the estimates of the rigid model."""

    motor: Mapping[int, float]  # [kg m^2] by joint, from 1
    link: Mapping[int, float]  # [kg m^2] by joint, from 1
    rigid: Mapping[Key, float | None]  # None: not identified
    rigid_std: Mapping[Key, float]
    combinations: Mapping[Key, Row]  # of link parameters and motor inertias, in the rigid model

    def require_rigid(self, name: str) -> float:
        """Return a parameter of the arm that only the rigid model provides.

        Raises NotIdentifiable if the motion records do not identify it.
        """
        value = self.rigid.get((name, None))
        if value is None:
            raise NotIdentifiable(
                f"the whole-arm fit needs {name}, which the motion records do not identify: record"
                ' all joints moving together with use = "motion"'
            )
        return value


def is_positive(value: float | None) -> bool:
    """Whether the value is known, finite and positive."""
    return value is not None and bool(np.isfinite(value)) and value > 0.0


def require_positive(name: str, value: float) -> float:
    """Return the value. Raises NotIdentifiable unless it is positive."""
    if not is_positive(value):
        raise NotIdentifiable(
            f"the whole-arm fit has no starting values: the earlier steps estimate {name} ="
            f" {value:.3g}, which is impossible. Check the signs, units and assignment of the"
            " channels, gear_ratio and torque_per_volt"
        )
    return value
