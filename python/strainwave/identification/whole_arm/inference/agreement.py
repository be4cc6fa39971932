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
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.keys import Values
from strainwave.domain.results.distributions import chi_square_tail
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_of, with_variances
from strainwave.identification.whole_arm.problem.parameter_space import reference_sizes
from strainwave.identification.whole_arm.search.fit import Fit

_Group = tuple[Literal["all", "inertias", "friction"], int | None]  # scope and joint of a test

RIGID_MODEL_ERROR = 5e-4
"""Relative error of the rigid model's values, because torsion moves the links by milliradians."""

# standard deviation of a difference, relative to the rigid step, below which the records add no
# information
_MIN_STD_RATIO = 0.05
_MIN_EIGENVALUE_RATIO = 1e-9  # relative eigenvalue below which the rigid correlations are singular
_BISECTIONS = 60  # of the variance of model errors
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


def agreement_tests(fit: Fit) -> tuple[tuple[AgreementTest, ...], Values]:
    """Chi-square tests of the differences: all values, inertias, and the friction of each joint.

    Also returns the squared model errors of the values in tests that fail. The covariance of the
    difference accounts for the errors that both stages share (Hausman, 1978), so only the excess is
    an error of the model. The test of all values tells nothing new if another fails.

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
    model_error = np.diag((RIGID_MODEL_ERROR * size) ** 2)
    groups: dict[_Group, list[int]] = {}
    for k, (name, joint) in enumerate(prior.names):
        group_key: _Group = ("inertias", None)
        if family_of(name) in ("dry friction", "damping"):
            group_key = ("friction", joint)
        for group in (("all", None), group_key):
            groups.setdefault(group, []).append(k)
    tests: list[AgreementTest] = []
    excess: dict[_Group, Values] = {}
    for (scope, joint), rows in groups.items():
        block, own = np.ix_(rows, rows), difference[rows]
        chi_square, degrees = _chi_square(own, covariance[block], rigid[block], model_error[block])
        if not degrees:
            continue
        largest = float(np.max(np.abs(own) / size[rows]))
        deviations = _as_normal(chi_square, degrees)
        tests.append(AgreementTest(scope, joint, chi_square, degrees, deviations, largest))
        if tests[-1].disagrees:
            variance, biases = (covariance + model_error)[block], prior.typical_biases[rows]
            errors = expected_model_error(own, variance, biases, degrees).tolist()
            excess[scope, joint] = {prior.names[k]: e**2 for k, e in zip(rows, errors, strict=True)}
    if len(excess) > 1:
        excess.pop(("all", None), None)
    return tuple(tests), {key: square for each in excess.values() for key, square in each.items()}


def expected_model_error(
    difference: FloatArray, covariance: FloatArray, sizes: FloatArray, degrees: int
) -> FloatArray:
    """Part of a difference d that is a model error, by its covariance C: (n_rows,).

    Model errors have variances t^2 S, with typical `sizes` as roots of S, and t explains the excess
    of the chi square, d' (C + t^2 S)^-1 d = `degrees` (Mandel and Paule, 1970). The expected error
    t^2 S (C + t^2 S)^-1 d is all of a difference far above its standard deviation, and little else.
    """
    variances, vectors = np.linalg.eigh(covariance / np.outer(sizes, sizes))
    variances = np.maximum(variances, np.finfo(float).eps * variances[-1])
    scaled = vectors.T @ (difference / sizes)
    low, high = 0.0, float(scaled @ scaled)
    for _ in range(_BISECTIONS):
        t2 = 0.5 * (low + high)
        is_small = np.sum(scaled**2 / (variances + t2)) > degrees
        low, high = (t2, high) if is_small else (low, t2)
    return np.asarray(sizes * (vectors @ (scaled * t2 / (variances + t2))))


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
