"""Selection of the optional parameters of the model.

The coarse stage, in long integrator steps, only adds parameters. The fine stage also removes
parameters that are not significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.selection.candidate import Candidate, Selection
from strainwave.identification.whole_arm.selection.further_unknowns import (
    add_named_effects,
    add_settling_times,
    add_significant_initial_motion,
    extend_ranges,
    remove_insignificant_effects,
    remove_insignificant_settling_times,
)
from strainwave.identification.whole_arm.selection.gear_laws import (
    remove_insignificant_stiffness_terms,
    restart_coarse_fit,
    restart_fine_fit,
    select_gear_laws,
    straighten_curves,
)
from strainwave.identification.whole_arm.selection.mountings import (
    add_significant_tilts,
    improve_mountings,
)
from strainwave.identification.whole_arm.selection.sensor_constants import (
    add_sensor_bandwidths,
    add_significant_sensor_constants,
    remove_insignificant_sensor_constants,
)
from strainwave.identification.whole_arm.selection.sensor_mounts import add_mount_resonances

COARSE: tuple[Candidate, ...] = (
    add_significant_initial_motion,
    improve_mountings,
    select_gear_laws,
    restart_coarse_fit,
    partial(add_significant_sensor_constants, coarse=True),
    partial(add_sensor_bandwidths, coarse=True),
    add_settling_times,
    add_named_effects,
)
"""Candidates of a coarse fit, in the order of their trials."""

FINE: tuple[Candidate, ...] = (
    extend_ranges,
    restart_fine_fit,
    remove_insignificant_stiffness_terms,
    remove_insignificant_effects,
    partial(add_significant_sensor_constants, coarse=False),
    partial(add_sensor_bandwidths, coarse=False),
    add_mount_resonances,
    add_significant_tilts,
    remove_insignificant_sensor_constants,
    remove_insignificant_settling_times,
    straighten_curves,
)
"""Candidates of the fine fit, in the order of their trials."""


def select_model(fit: Fit, candidates: Sequence[Candidate], selection: Selection) -> Fit:
    """Select the model that the data support.

    Each of the `candidates` starts from the result of the candidate before it.
    """
    for candidate in candidates:
        fit = candidate(fit, selection)
    return fit
