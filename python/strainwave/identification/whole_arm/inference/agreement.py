"""Agreement of the whole-arm fit with the rigid model, which is its prior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np

from strainwave.domain import (
    AgreementTest,
    Clause,
    Diagnostic,
    FloatArray,
    Place,
    StageDifference,
)
from strainwave.domain.distributions import chi_square_tail
from strainwave.domain.keys import Values
from strainwave.domain.parameter_table import family_of
from strainwave.domain.units import unit_in
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_of, with_variances
from strainwave.identification.whole_arm.problem.prior import reference_sizes
from strainwave.identification.whole_arm.search.fit import Fit

Scope = Literal["all", "inertias", "friction"]

RIGID_MODEL_ERROR = 5e-4
"""Relative error of the rigid model's values, because torsion moves the links by milliradians."""

# standard deviation of a difference, relative to the rigid step, below which the records add no
# information
_MIN_STD_RATIO = 0.05
_MIN_EIGENVALUE_RATIO = 1e-9  # relative eigenvalue below which the rigid correlations are singular
_MIN_TAIL_PROBABILITY = 1e-300  # lower limit of a tail probability; equals 37 standard deviations


def stage_differences(fit: Fit, arm: Arm) -> tuple[StageDifference, ...]:
    """Differences between rigid model and whole-arm fit, with their standard deviations.

    The rigid model is the prior of the fit; `covariance.residual_covariance` includes the resulting
    correlation. `fit` is at its minimum. Values without information in the fast records are
    omitted. The result is empty without a rigid model.
    """
    prior, confidence = fit.space.prior, confidence_of(fit)
    F = prior.factor
    difference = F @ confidence.prior_residual
    std = _standard_deviations([F @ part @ F.T for part in confidence.prior_covariance])
    rigid_std = _standard_deviations([F @ prior.errors @ F.T])
    differences = []
    for k, (name, joint) in enumerate(prior.names):
        if std[k] <= _MIN_STD_RATIO * rigid_std[k]:
            continue
        unit = unit_in(arm, (name, joint))
        rigid = float(prior.mean[k])
        whole_arm = rigid + float(difference[k])
        differences.append(StageDifference(name, joint, rigid, whole_arm, float(std[k]), unit))
    return tuple(differences)


def _standard_deviations(covariances: Sequence[FloatArray]) -> FloatArray:
    """Largest standard deviation of each row over the covariances: (n_rows,)."""
    variances = np.max([np.diag(part) for part in covariances], axis=0)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


def agreement_tests(fit: Fit) -> tuple[AgreementTest, ...]:
    """Chi-square tests of the differences: all values, inertias, and the friction of each joint.

    The statistic is d' C^-1 d with the differences d and their covariance C. C has the correlations
    of steady errors, which about 1,000 rows determine, and the larger of both variances, to which
    the squares of `RIGID_MODEL_ERROR` are added. Only directions in which the records add
    information to the rigid model are included.

    `fit` is at its minimum. The result is empty without a rigid model, or if the records contain no
    information on its values.
    """
    prior, confidence = fit.space.prior, confidence_of(fit)
    F = prior.factor
    _, steady = (F @ part @ F.T for part in confidence.prior_covariance)
    std = _standard_deviations([F @ part @ F.T for part in confidence.prior_covariance])
    covariance = with_variances(steady, std**2)
    rigid, difference = F @ prior.errors @ F.T, F @ confidence.prior_residual
    sizes = reference_sizes(dict(zip(prior.names, prior.mean.tolist(), strict=True)))
    size = np.maximum(list(sizes.values()), 1e-300)
    relative = np.abs(difference) / size
    model_error = np.diag((RIGID_MODEL_ERROR * size) ** 2)
    groups: dict[tuple[Scope, int | None], list[int]] = {}
    for k, (name, joint) in enumerate(prior.names):
        group_key: tuple[Scope, int | None] = ("inertias", None)
        if family_of(name) in ("dry friction", "damping"):
            group_key = ("friction", joint)
        for group in (("all", None), group_key):
            groups.setdefault(group, []).append(k)
    tests = []
    for (scope, joint), rows in groups.items():
        block = np.ix_(rows, rows)
        chi_square, degrees = _chi_square(
            difference[rows], covariance[block], rigid[block], model_error[block]
        )
        if degrees:
            largest = float(np.max(relative[rows]))
            tests.append(
                AgreementTest(
                    scope, joint, chi_square, degrees, _as_normal(chi_square, degrees), largest
                )
            )
    return tuple(tests)


def _chi_square(
    difference: FloatArray, covariance: FloatArray, rigid: FloatArray, added: FloatArray
) -> tuple[float, int]:
    """Statistic d' (C + added)^-1 d and its degrees of freedom.

    Directions in which C is negligible relative to the rigid covariance are omitted.
    """
    rigid_std = np.sqrt(np.diag(rigid))
    values, vectors = np.linalg.eigh(rigid / np.outer(rigid_std, rigid_std))
    is_regular = values > _MIN_EIGENVALUE_RATIO * values[-1]
    whiten = (vectors[:, is_regular] / np.sqrt(values[is_regular])).T / rigid_std
    ratios, directions = np.linalg.eigh(whiten @ covariance @ whiten.T)
    informative = directions.T[ratios > _MIN_STD_RATIO**2] @ whiten
    projection = informative @ difference
    total = informative @ (covariance + added) @ informative.T
    return float(projection @ np.linalg.solve(total, projection)), len(projection)


def _as_normal(chi_square: float, degrees: int) -> float:
    tail = max(chi_square_tail(chi_square, degrees), _MIN_TAIL_PROBABILITY)
    return max(0.0, -NormalDist().inv_cdf(0.5 * tail))


def stage_excess(differences: Sequence[StageDifference], tests: Sequence[AgreementTest]) -> Values:
    """Excess of the squared differences over their variance, if the stages disagree.

    The covariance of the difference accounts for the errors that both stages share (Hausman, 1978),
    so only the excess is an error of the model.
    """
    if not any(test.disagrees for test in tests):
        return {}
    return {d.key: max(0.0, (d.whole_arm - d.rigid) ** 2 - d.std**2) for d in differences}


def disagreement(
    differences: Sequence[StageDifference], tests: Sequence[AgreementTest]
) -> Iterator[Diagnostic]:
    """Yield the warning that the stages disagree; at most one."""
    failed = [test for test in tests if test.disagrees]
    if not failed:
        return
    worst = max(failed, key=lambda test: test.deviations)
    largest = tuple(
        Clause(
            "stage-difference",
            parameter=Place(joint=d.joint, parameter=d.name),
            rigid=d.rigid,
            whole_arm=d.whole_arm,
            unit=d.unit,
        )
        for d in sorted(differences, key=lambda d: -abs(d.deviations))[:3]
    )
    yield Diagnostic(
        "stages-disagree",
        Place(part="rigid and whole-arm fit"),
        subject=worst.subject,
        deviations=worst.deviations,
        chi_square=worst.chi_square,
        degrees=worst.degrees,
        largest=largest,
    )
