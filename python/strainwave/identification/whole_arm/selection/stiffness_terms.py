"""Removal of stiffness terms that do not differ significantly from zero."""

from __future__ import annotations

import numpy as np

from strainwave.domain.keys import Key
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search
from strainwave.identification.whole_arm.selection.candidate import MIN_SIGNIFICANCE_STDS, Selection


def remove_insignificant_stiffness_terms(fit: Fit, selection: Selection) -> Fit:
    """Repeat the fit without the optional terms of gear laws that are not significant.

    Returns the fit itself if all terms are significant.
    """
    insignificant = _insignificant_terms(fit, selection)
    if not insignificant:
        return fit
    space = fit.space.fix_values(dict.fromkeys(insignificant, 0.0))
    return fine_search(fit.with_unknowns(space), selection.options)


def _insignificant_terms(fit: Fit, selection: Selection) -> list[Key]:
    """Optional parameters of gear laws that are zero within their errors.

    A chi-square distance tests all optional parameters of a gear together.
    """
    keys, insignificant = fit.space.keys, list[Key]()
    for number, joint in enumerate(selection.arm.joints, start=1):
        names = joint.law.may_vanish
        places = [k for k, (name, of) in enumerate(keys) if of == number and name in names]
        if places:
            estimate = fit.space.parameters(fit.z)[places]
            covariance = confidence_of(fit).cautious[np.ix_(places, places)]
            if estimate @ np.linalg.solve(covariance, estimate) < MIN_SIGNIFICANCE_STDS**2:
                insignificant += [keys[k] for k in places]
    return insignificant
