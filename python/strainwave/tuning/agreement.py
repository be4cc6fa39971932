"""Fit with its prior, the rigid model -> whether they agree on the values that both give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.parameters import unit_of
from strainwave.records import Diagnostic, FloatArray, StageDifference, Study
from strainwave.tuning.estimates import Fit
from strainwave.tuning.parametrisation import unit_of_arm

DISAGREES = 3.0
"""Standard deviations of a difference from which it is a finding: 3 runs in 100 by noise alone.

From `records.final_table.CONTRADICTION` on, what it touches is rejected.
"""

_NOTHING_NEW = 0.05  # of the rigid deviation: a smaller one says that the records add nothing


def stage_differences(fit: Fit, study: Study) -> tuple[StageDifference, ...]:
    """Values of the rigid model beside the whole-arm fit's, with the deviation of the difference.

    The fit follows the rigid model, its prior; `confidence.residual_covariance` counts that.

    Parameters
    ----------
    fit : Fit
        At its minimum.
    study : Study

    Returns
    -------
    tuple of StageDifference
        Without values that the fast records say nothing of; none where there was no rigid model.
    """
    prior, sure = fit.misfit.search.prior, fit.confidence
    F = prior.factor
    difference = F @ sure.prior_residual
    std = _deviations([F @ part @ F.T for part in sure.prior_covariance])
    rigid_std = _deviations([F @ prior.errors @ F.T])
    found = []
    for k, (name, joint) in enumerate(prior.names):
        if std[k] <= _NOTHING_NEW * rigid_std[k]:
            continue
        unit = unit_of_arm(name) if joint is None else unit_of(name, study.joints[joint - 1])
        rigid = float(prior.mean[k])
        whole = rigid + float(difference[k])
        found.append(StageDifference(name, joint, rigid, whole, float(std[k]), unit))
    return tuple(found)


def _deviations(covariances: Sequence[FloatArray]) -> FloatArray:
    """Of each row the largest standard deviation: (n_rows,)."""
    variances = np.max([np.diag(part) for part in covariances], axis=0)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def disagreement(differences: Sequence[StageDifference]) -> Iterator[Diagnostic]:
    """The warning that the stages disagree, if they do.

    Parameters
    ----------
    differences : sequence of StageDifference

    Yields
    ------
    Diagnostic
        At most one, with the likely causes, the likeliest first.
    """
    far = sorted(differences, key=lambda d: -abs(d.deviations))
    far = [d for d in far if abs(d.deviations) > DISAGREES]
    if not far:
        return
    shown = ", ".join(
        f"{d.name if d.joint is None else f'{d.name} of joint {d.joint}'} "
        f"{d.rigid:.4g} by the rigid and {d.whole_arm:.4g} {d.unit} by the whole-arm fit"
        for d in far[:3]
    )
    text = f"they differ by up to {abs(far[0].deviations):.1f} standard deviations: {shown}; likely"
    text += " causes in this order: a motor constant that falls with current, a clock that is fast"
    text += " or slow, a dead zone of the drive, another law of friction"
    yield Diagnostic("stages-disagree", "rigid and whole-arm fit", text)
