"""Which parameters the model has: candidates in turn, each judged by what the records say.

Near the minimum, in long steps of the integrator, candidates only join; at the minimum those leave
that the records do not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from strainwave.identification.whole_arm.causes import with_demanded_effects
from strainwave.identification.whole_arm.effect_candidates import (
    with_named_effects,
    without_idle_effects,
)
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.idle_curves import without_idle_curves
from strainwave.identification.whole_arm.initial_motion import with_evident_initial_motion
from strainwave.identification.whole_arm.mountings import with_better_mountings, with_evident_tilts
from strainwave.identification.whole_arm.selection import Candidate, Selection
from strainwave.identification.whole_arm.sensor_mounts import with_ringing_mounts
from strainwave.identification.whole_arm.sensors import (
    with_bandwidths_apart,
    with_evident_sensors,
    without_idle_sensors,
)
from strainwave.identification.whole_arm.settling import (
    with_settling_times,
    without_idle_settling,
)
from strainwave.identification.whole_arm.stiffness_restarts import (
    with_fine_stiffness_restarts,
    with_stiffness_restarts,
)

COARSE: tuple[Candidate, ...] = (
    with_evident_initial_motion,
    with_better_mountings,
    with_stiffness_restarts,
    partial(with_evident_sensors, coarse=True),
    partial(with_bandwidths_apart, coarse=True),
    with_settling_times,
    with_named_effects,
)
"""Of a coarse fit, in the order in which they are tried."""

FINE: tuple[Candidate, ...] = (
    with_fine_stiffness_restarts,
    without_idle_curves,
    without_idle_effects,
    partial(with_evident_sensors, coarse=False),
    partial(with_bandwidths_apart, coarse=False),
    with_ringing_mounts,
    with_evident_tilts,
    without_idle_sensors,
    without_idle_settling,
    with_demanded_effects,
)
"""Of the fit itself."""


def selected(fit: Fit, candidates: Sequence[Candidate], selection: Selection) -> Fit:
    """The fit of the model that the records speak for.

    `candidates`: Tried in turn, each on what those before it left.
    """
    for candidate in candidates:
        fit = candidate(fit, selection)
    return fit
