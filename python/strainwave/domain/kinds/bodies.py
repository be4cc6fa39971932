"""Rigid bodies: one of many sets of masses that share an arm's base parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

ASSUMED_LENGTH = 1.0
"""[m] Of a link whose study names no length."""


@dataclass(frozen=True, slots=True)
class Body:
    """One link as a rigid body; its centre of mass lies on its x axis."""

    mass: float  # [kg]
    centre: float  # [m] from its own axis; negative beyond it
    inertia: float  # [kg m^2] about the centre of mass


class Needed(Protocol):
    """Gives a parameter's value by name and joint, or refuses where there is none."""

    def __call__(self, name: str, joint: int | None = None) -> float:
        """The value."""


def about_axis(inertia: float, moment: float, length: float) -> Body:
    """A body with given inertia and first moment about its axis.

    m = 3 J/l^2 + s^2/J: a uniform rod's mass, and what keeps the inertia about the centre of mass,
    J - s^2/m = (3 J/l^2) J/m, positive.

    `inertia` [kg m^2]: J > 0, about the axis. `moment` [kg m]: s, first moment. `length` [m]: l, of
    the rod.
    """
    rod = 3.0 * inertia / length**2
    mass = rod + moment**2 / inertia
    return Body(mass, moment / mass, inertia * rod / mass)
