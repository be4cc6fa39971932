"""Fit with its prior, the rigid model -> whether they agree on the values that both give."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import NormalDist
from typing import Literal

import numpy as np

from strainwave.domain import (
    AgreementTest,
    Cause,
    Diagnostic,
    FloatArray,
    StageDifference,
    SuspectConstant,
)
from strainwave.domain.effects import effect_named
from strainwave.domain.parameters import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.effects import rigid_body, rigid_friction
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated
from strainwave.identification.whole_arm.parametrisation import COULOMB, OFFSET, Key
from strainwave.numerics.distributions import chi_square_tail

Scope = Literal["all", "inertias", "friction"]

MAX_NOISE_DEVIATIONS = 3.0
"""Standard deviations up to which a disagreement is noise: one run in 100 exceeds it by chance.

From `domain.arm_model.MAX_DISAGREEMENT` on, the values concerned are rejected.
"""

MIN_EXPLAINED_SHARE = 0.1
"""Share of the cost from which a hypothesis explains a disagreement at all."""

MAX_SUSPECTS = 3  # that a message lists
LENGTH_STEP = 1e-4  # share of a length over which records are differentiated

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


def is_disagreement(tests: Sequence[AgreementTest]) -> bool:
    """Whether the stages disagree by more than noise and by more than a use of the model minds."""
    return any(test.deviations > MAX_NOISE_DEVIATIONS and test.matters for test in tests)


def suspects_of(fit: Fit, arm: Arm, causes: Sequence[Cause]) -> tuple[SuspectConstant, ...]:
    """What would explain that the stages disagree, the likeliest first.

    Each hypothesis joins the unknowns of the fit as further columns: derivatives of the records by
    a constant of the study, or shifts of what the rigid model knows, for a payload or a friction
    that changed between slow and fast records. Its share is what one linear step takes off the
    cost, which includes the rigid model as prior. Effects were fitted before; their shares join.
    """
    prior = fit.objective.space.prior
    hypotheses = [
        (
            SuspectConstant(
                "payload", None, 0.0, experiment="repeat the motion with the load of fast records"
            ),
            rigid_body(arm),
        )
    ]
    for joint in range(1, arm.n_joints + 1):
        change = "repeat the motion directly after the fast records"
        hypotheses.append(
            (
                SuspectConstant("changed friction", joint, 0.0, experiment=change),
                rigid_friction(arm, joint),
            )
        )
    suspects = [
        replace(one, share=_share(fit, shifted=prior.by_shifts(names)))
        for one, names in hypotheses
        if any(name in names for name in prior.names)
    ]
    if arm.link_length is not None:
        suspects += _link_length(fit, arm.link_length)
    suspects += [
        SuspectConstant(
            cause.effect, cause.joint, cause.share, experiment=effect_named(cause.effect).experiment
        )
        for cause in causes
    ]
    explaining = [one for one in suspects if one.share > MIN_EXPLAINED_SHARE]
    return tuple(sorted(explaining, key=lambda one: -one.share)[:MAX_SUSPECTS])


def _link_length(fit: Fit, length: float) -> Iterator[SuspectConstant]:
    """The distance of the joints' axes, which accelerations of the second link depend on."""
    values, objective = fit.objective.space.values(fit.z), fit.objective

    def column(k: int, evaluated: Evaluated) -> FloatArray:
        """Derivative by the logarithm of the length: (n_rows, n_channels, 1)."""
        record = objective.records[k]
        own = evaluated.own[: len(record.local)]
        ends = [
            replace(record, arm=replace(record.arm, link_length=length * factor)).linearised(
                values, own, ()
            )[0]
            for factor in (1.0 + LENGTH_STEP, 1.0 - LENGTH_STEP)
        ]
        return np.asarray((ends[0] - ends[1])[..., None] / (2.0 * LENGTH_STEP))

    try:
        factor = objective.bordered(fit.z, 1, column)
    except (InvalidInput, NumericalFailure):
        return
    n = len(objective.space.unknowns)
    own, target = factor[n:, n], factor[n:, -1]
    square = float(own @ own)
    if square > 0.0:
        step = -float(own @ target) / square
        share = step**2 * square / max(fit.cost, 1e-300)
        value = length * math.exp(step)
        text = "measure the distance between the axes of both joints"
        yield SuspectConstant("link_length", None, share, value, "m", text)


def _share(fit: Fit, shifted: FloatArray) -> float:
    """Share of the cost that shifts of the prior's rows, (n_prior, n_shifts), take off."""
    n, width = len(fit.objective.space.unknowns), shifted.shape[1]

    def nothing(_: int, evaluated: Evaluated) -> FloatArray:
        return np.zeros((*evaluated.difference.shape, width))

    factor = fit.objective.bordered(fit.z, width, nothing, shifted)
    own, target = factor[n:, n:-1], factor[n:, -1]
    left = target - own @ np.linalg.lstsq(own, target)[0]
    return float((target @ target - left @ left) / max(fit.cost, 1e-300))


def disagreement(
    differences: Sequence[StageDifference],
    tests: Sequence[AgreementTest],
    suspects: Sequence[SuspectConstant] = (),
) -> Iterator[Diagnostic]:
    """The warning that the stages disagree, with the likely causes; at most one."""
    if not is_disagreement(tests):
        return
    worst = max((t for t in tests if t.matters), key=lambda test: test.deviations)
    shown = ", ".join(
        f"{d.name if d.joint is None else f'{d.name} of joint {d.joint}'} "
        f"{d.rigid:.4g} by the rigid and {d.whole_arm:.4g} {d.unit} by the whole-arm fit"
        for d in sorted(differences, key=lambda d: -abs(d.deviations))[:3]
    )
    text = (
        f"taken together, {worst.subject} differ by {worst.deviations:.1f} standard deviations"
        f" (chi-square {worst.chi_square:.4g} of {worst.degrees} degrees), most in {shown}"
    )
    if suspects:
        listed = ", or ".join(one.text for one in suspects)
        text += f"; likely causes in this order: {listed}"
    else:
        text += "; likely causes in this order: a motor constant that falls with current (record"
        text += " with less voltage), a clock that is fast or slow, a dead zone of the drive,"
        text += " another law of friction"
    yield Diagnostic("stages-disagree", "rigid and whole-arm fit", text)
