"""Parameters at a bound of their range after a fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.keys import Key
from strainwave.domain.parameter_table import SETTLING
from strainwave.domain.ranges import physical_range
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.search.fit import Fit

# distance to a bound, relative to half the range, that counts as at the bound
_BOUND_TOLERANCE = 0.01


def parameters_at_bounds(fit: Fit, arm: Arm) -> Iterator[Key]:
    """Yield the parameters at a bound, and the inertias that contain them, as (name, joint).

    The total viscous friction of a joint is omitted, because it can be identifiable although its
    parts are not.
    """
    keys = fit.space.keys
    ended = [key for key, at in zip(keys, at_bounds(fit), strict=True) if at and key[0] != SETTLING]
    yield from ended
    links = {key: row for key, row in arm.reported.items() if key[0] == "link_inertia"}
    for key, parts in (*arm.lumped_inertias.items(), *links.items()):
        if key not in ended and any(part in ended for part in parts):
            yield key


def at_bounds(fit: Fit) -> list[bool]:
    """Whether each unknown is at a bound of its search range that is no physical bound of zero."""
    near = _is_near(fit.space.upper - fit.z, fit) | _is_near(fit.z - fit.space.lower, fit)
    return [at and not zero for at, zero in zip(near.tolist(), at_zero(fit), strict=True)]


def at_zero(fit: Fit) -> list[bool]:
    """Whether each unknown is at the lower bound of a range that begins at zero."""
    may_vanish = [physical_range(name) == "non-negative" for name, _ in fit.space.keys]
    zeros: list[bool] = (_is_near(fit.z - fit.space.lower, fit) & np.array(may_vanish)).tolist()
    return zeros


def _is_near(distance: FloatArray, fit: Fit) -> BoolArray:
    margin = 0.5 * _BOUND_TOLERANCE * (fit.space.upper - fit.space.lower)
    return np.asarray(distance < margin)
