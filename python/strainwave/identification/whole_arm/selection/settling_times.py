"""Selection of friction settling times."""

from __future__ import annotations

import numpy as np

from strainwave.domain.parameter_table import SETTLING
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.problem.arm_unknowns import (
    SETTLING_START,
    add_settling_unknowns,
)
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.selection.candidate import (
    MAX_CANDIDATE_EVALUATIONS,
    MIN_SIGNIFICANCE_STDS,
    Selection,
    refit_without,
    run_trial,
    select_better,
)

# share of the lower bound of its logarithm from which a settling time is zero
_ZERO_BOUND_SHARE = 0.99


def add_settling_times(fit: Fit, selection: Selection) -> Fit:
    """Add a friction settling time to each joint of a coarse fit.

    Keeps them if the options require them or the cost decreases significantly.
    """
    required = selection.options.settling
    if required is False or selection.has_ended(fit):
        return fit
    space = add_settling_unknowns(fit.space)
    starts = {key: SETTLING_START for key in space.keys if key[0] == SETTLING}
    max_evaluations = None if required else MAX_CANDIDATE_EVALUATIONS
    extended = run_trial(fit.with_unknowns(space, starts), selection, max_evaluations)
    return select_better(fit, extended) if required is None else extended


def remove_insignificant_settling_times(fit: Fit, selection: Selection) -> Fit:
    """Repeat the fit without settling times that are not significant.

    The friction of those joints acts instantly.
    """
    if selection.options.settling or all(name != SETTLING for name, _ in fit.space.keys):
        return fit
    values = fit.values
    stds = np.sqrt(np.diag(confidence_of(fit).cautious))
    at_lower_bound = fit.z < _ZERO_BOUND_SHARE * fit.space.lower
    insignificant = {
        key: 0.0
        for key, std, is_at_bound in zip(fit.space.keys, stds, at_lower_bound, strict=True)
        if key[0] == SETTLING and (is_at_bound or values[key] < MIN_SIGNIFICANCE_STDS * std)
    }
    return refit_without(insignificant, fit, selection)
