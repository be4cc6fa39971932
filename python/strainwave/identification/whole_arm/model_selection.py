"""Selection of the optional parameters of the model.

The coarse stage, in long integrator steps, only adds parameters. The fine stage also removes
parameters that are not significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from strainwave.identification.whole_arm.causes import add_significant_effects
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
"""Candidates of a coarse fit, in the order of their trials."""

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
    add_significant_effects,
)
"""Candidates of the fine fit, in the order of their trials."""


def selected(fit: Fit, candidates: Sequence[Candidate], selection: Selection) -> Fit:
    """Select the model that the data support.

    Each of the `candidates` starts from the result of the candidate before it.
    """
    for candidate in candidates:
        fit = candidate(fit, selection)
    return fit
