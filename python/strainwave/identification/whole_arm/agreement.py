"""Fit with its prior, the rigid model -> whether they agree on the values that both give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np

from strainwave.domain import AgreementTest, Diagnostic, FloatArray, StageDifference
from strainwave.domain.parameters import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.parametrisation import COULOMB, OFFSET, Key
from strainwave.numerics.distributions import chi_square_tail

Scope = Literal["all", "inertias", "friction"]

DISAGREES = 3.0
"""Standard deviations from which a disagreement is a finding: a run in a hundred by noise alone.

From `domain.arm_model.MAX_DISAGREEMENT` on, what it touches is rejected.
"""

_NOTHING_NEW = 0.05  # of the rigid deviation: a smaller one says that the records add nothing
_SINGULAR = 1e-9  # of the rigid correlations: along such a direction the values are one
_LEAST_TAIL = 1e-300  # of a probability, 37 deviations


def stage_differences(fit: Fit, arm: Arm) -> tuple[StageDifference, ...]:
    """Values of the rigid model beside the whole-arm fit's, with the deviation of the difference.

    The fit follows the rigid model, its prior; `confidence.residual_covariance` counts that.

    Parameters
    ----------
    fit : Fit
        At its minimum.
    arm : Arm

    Returns
    -------
    tuple of StageDifference
        Without values that the fast records say nothing of; none where there was no rigid model.
    """
    prior, sure = fit.objective.space.prior, fit.confidence
    F = prior.factor
    difference = F @ sure.prior_residual
    std = _deviations([F @ part @ F.T for part in sure.prior_covariance])
    rigid_std = _deviations([F @ prior.errors @ F.T])
    found = []
    for k, (name, joint) in enumerate(prior.names):
        if std[k] <= _NOTHING_NEW * rigid_std[k]:
            continue
        unit = unit_of(name, None if joint is None else arm.joints[joint - 1])
        rigid = float(prior.mean[k])
        whole = rigid + float(difference[k])
        found.append(StageDifference(name, joint, rigid, whole, float(std[k]), unit))
    return tuple(found)


def _deviations(covariances: Sequence[FloatArray]) -> FloatArray:
    """Of each row the largest standard deviation: (n_rows,)."""
    variances = np.max([np.diag(part) for part in covariances], axis=0)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def agreement_tests(fit: Fit) -> tuple[AgreementTest, ...]:
    """Chi-squares of the differences: of all of them, of inertias, and of each joint's friction.

    d' C^-1 d, d the differences and C their covariance: the correlations of steady errors, which a
    thousand rows know, with the larger one of both variances. Only directions count in which the
    records add to what the rigid model knows.

    Parameters
    ----------
    fit : Fit
        At its minimum.

    Returns
    -------
    tuple of AgreementTest
        None where there was no rigid model, or the records say nothing of its values.
    """
    prior, sure = fit.objective.space.prior, fit.confidence
    F = prior.factor
    _, steady = (F @ part @ F.T for part in sure.prior_covariance)
    std = _deviations([F @ part @ F.T for part in sure.prior_covariance])
    own = np.sqrt(np.maximum(np.diag(steady), 0.0))
    raised = np.divide(std, own, out=np.ones_like(std), where=own > 0.0)
    covariance = steady * np.outer(raised, raised)
    rigid, difference = F @ prior.errors @ F.T, F @ sure.prior_residual
    relative = np.abs(difference) / _sizes(prior.names, prior.mean)
    groups: dict[tuple[Scope, int | None], list[int]] = {}
    for k, (name, joint) in enumerate(prior.names):
        own_group: tuple[Scope, int | None] = ("inertias", None)
        if "friction" in name:
            own_group = ("friction", joint)
        for group in (("all", None), own_group):
            groups.setdefault(group, []).append(k)
    found = []
    for (scope, joint), at in groups.items():
        own_part = np.ix_(at, at)
        q, degrees = _chi_square(difference[at], covariance[own_part], rigid[own_part])
        if degrees:
            largest = float(np.max(relative[at]))
            found.append(AgreementTest(scope, joint, q, degrees, _as_normal(q, degrees), largest))
    return tuple(found)


def _sizes(names: Sequence[Key], values: FloatArray) -> FloatArray:
    """What differences are relative to: the values, of an offset the joint's Coulomb friction."""
    at = {key: abs(float(value)) for key, value in zip(names, values, strict=True)}
    own = [(COULOMB, joint) if name == OFFSET else (name, joint) for name, joint in names]
    sizes = [at.get(key, at[name]) for key, name in zip(own, names, strict=True)]
    return np.asarray(np.maximum(np.array(sizes), 1e-300))


def _chi_square(
    difference: FloatArray, covariance: FloatArray, rigid: FloatArray
) -> tuple[float, int]:
    """D' C^-1 d over the directions in which C is not nothing beside the rigid covariance."""
    size = np.sqrt(np.diag(rigid))
    values, vectors = np.linalg.eigh(rigid / np.outer(size, size))
    known = values > _SINGULAR * values[-1]
    whiten = (vectors[:, known] / np.sqrt(values[known])).T / size
    share, directions = np.linalg.eigh(whiten @ covariance @ whiten.T)
    new = share > _NOTHING_NEW**2
    along = directions.T[new] @ (whiten @ difference)
    return float(np.sum(along**2 / share[new])), int(np.count_nonzero(new))


def _as_normal(chi_square: float, degrees: int) -> float:
    tail = max(chi_square_tail(chi_square, degrees), _LEAST_TAIL)
    return max(0.0, -NormalDist().inv_cdf(0.5 * tail))


def disagreement(
    differences: Sequence[StageDifference], tests: Sequence[AgreementTest]
) -> Iterator[Diagnostic]:
    """The warning that the stages disagree, if they do.

    Parameters
    ----------
    differences : sequence of StageDifference
    tests : sequence of AgreementTest
        That decide it.

    Yields
    ------
    Diagnostic
        At most one, with the likely causes, the likeliest first.
    """
    mattering = [test for test in tests if test.matters]
    worst = max(mattering, key=lambda test: test.deviations, default=None)
    if worst is None or worst.deviations <= DISAGREES:
        return
    shown = ", ".join(
        f"{d.name if d.joint is None else f'{d.name} of joint {d.joint}'} "
        f"{d.rigid:.4g} by the rigid and {d.whole_arm:.4g} {d.unit} by the whole-arm fit"
        for d in sorted(differences, key=lambda d: -abs(d.deviations))[:3]
    )
    what = {
        "all": "the values",
        "inertias": "inertias",
        "friction": f"joint {worst.joint}'s friction",
    }
    text = (
        f"taken together, {what[worst.scope]} differ by {worst.deviations:.1f} standard deviations"
    )
    text += (
        f" (chi-square {worst.chi_square:.4g} of {worst.degrees} degrees), most in {shown}; likely"
    )
    text += " causes in this order: a motor constant that falls with current, a clock that is fast"
    text += " or slow, a dead zone of the drive, another law of friction"
    yield Diagnostic("stages-disagree", "rigid and whole-arm fit", text)
