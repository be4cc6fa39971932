"""Parameters that a fit left at the end of their ranges."""

from __future__ import annotations

from collections.abc import Iterator

from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.parametrisation import (
    SETTLING,
    Key,
)

_EDGE = 0.01  # of half its range, so near to which a parameter counts as at its bound


def parameters_at_bounds(fit: Fit, arm: Arm) -> Iterator[Key]:
    """Parameters that ended at the end of their range, and inertias that such ones are part of.

    A joint's total viscous friction is known where its split is not, and is spared.

    Parameters
    ----------
    fit : Fit
    arm : Arm

    Yields
    ------
    (name, joint)
    """
    keys = fit.objective.space.keys
    ended = [key for key, at in zip(keys, at_bounds(fit), strict=True) if at and key[0] != SETTLING]
    yield from ended
    links = {key: row for key, row in arm.reported.items() if key[0] == "link_inertia"}
    for key, parts in (*arm.lumped_inertias.items(), *links.items()):
        if key not in ended and any(part in ended for part in parts):
            yield key


def at_bounds(fit: Fit) -> list[bool]:
    """Which unknowns ended at the end of their range.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    list of bool
    """
    space = fit.objective.space
    edge = 0.5 * _EDGE * (space.upper - space.lower)
    near: list[bool] = ((fit.z < space.lower + edge) | (fit.z > space.upper - edge)).tolist()
    return near
