"""Rigid bodies: one choice of masses and centres of mass that has the arm's base parameters.

Estimates of earlier stages from which the whole-arm fit starts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from strainwave.domain.arm import Vector
from strainwave.domain.keys import Key, Row
from strainwave.errors import NotIdentifiable

LINK_PARAMETERS = (
    "mass",
    *(f"first_moment_{axis}" for axis in "xyz"),
    *(f"inertia_{entry}" for entry in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
"""Standard parameters of a link in the order of the core, without `link_`."""

ASSUMED_LENGTH = 1.0
"""Length [m] of a link if the study gives none."""


@dataclass(frozen=True, slots=True)
class Body:
    """One link as a rigid body, in the frame of its joint."""

    mass: float  # [kg]
    centre: Vector  # of mass [m]
    # Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass [kg m^2]
    inertia: tuple[float, float, float, float, float, float]

    @classmethod
    def of_standard(cls, parameters: Sequence[float]) -> Body:
        """Body with the values of `LINK_PARAMETERS`; its mass is positive."""
        mass, *moment = parameters[:4]
        x, y, z = (part / mass for part in moment)
        xx, xy, yy, xz, yz, zz = np.array(parameters[4:]) - mass * np.array(
            [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
        )
        return cls(mass, (x, y, z), (xx, yy, zz, xy, xz, yz))

    @classmethod
    def in_plane(cls, mass: float, centre: float, inertia: float) -> Body:
        """Body whose motion in the xy plane depends on Izz only, with its centre on the x axis."""
        return cls(mass, (centre, 0.0, 0.0), (inertia,) * 3 + (0.0,) * 3)


class ParameterLookup(Protocol):
    """Returns a parameter's value by name and joint; raises InvalidInput if it is unknown."""

    def __call__(self, name: str, joint: int | None = None) -> float:
        """Value of the parameter."""


def about_axis(inertia: float, moment: float, length: float) -> Body:
    """Body with inertia J > 0 [kg m^2] and first moment s [kg m] about its axis.

        m = 3 J/l^2 + s^2/J

    The first term is the mass of a uniform rod of the given length l [m]. The second keeps the
    inertia about the centre of mass, J - s^2/m = (3 J/l^2) J/m, positive.
    """
    rod_mass = 3.0 * inertia / length**2
    mass = rod_mass + moment**2 / inertia
    return Body.in_plane(mass, moment / mass, inertia * rod_mass / mass)


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
