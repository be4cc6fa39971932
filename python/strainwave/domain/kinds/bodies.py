"""Rigid bodies: one choice of masses and centres of mass that has the arm's base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from strainwave.domain.arm import Vector

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
