"""Conclusions from the fit at the best bandwidth: bounds and warnings.

Rotor inertia, viscous friction and Coulomb friction are bounded by zero. An estimate that is
negative by less than its interval is set to zero, and the others are estimated given it. The
covariance is that of the normal distribution truncated at the bound.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Place
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.domain.results.estimates import physical_range
from strainwave.identification.rigid.trial import MAX_ITERATIONS, RESONANCE_RATIO, Trial
from strainwave.numerics import least_squares as ls

MAX_NEGLIGIBLE_SHARE = 0.02
"""Share of the torque below which a value, or the half-width of an interval, is negligible."""

_AT_INTERVAL = 1.0 + 1e-9  # for rounding
_NORMAL = NormalDist()


@dataclass(frozen=True, slots=True)
class Bounded:
    """A fit with parameters at their bounds."""

    trial: Trial
    covariance: FloatArray  # (n_parameters, n_parameters) about the estimates
    # parameter at zero -> upper end of its one-sided 95 % interval
    upper: Mapping[int, float] = field(default_factory=dict)


def bound(trial: Trial, covariance: FloatArray) -> Bounded:
    """Set estimates to zero that are negative within their intervals, by an active set.

    The covariance includes the model error. Parameters that are negative beyond their intervals
    keep their values: the model contradicts the data. If the value is negligible, the interval is
    widened to zero instead, because the model error is at least as large.
    """
    columns = trial.arm.rigid_columns
    upper: dict[int, float] = {}
    width = trial.interval_half_width
    bounded = [k for k, c in enumerate(columns) if has_zero_bound(c.name) and trial.determined[k]]
    solution, fit = trial.solution, trial
    torque = float(np.linalg.norm(trial.factor.root * trial.equations.target))
    covariance = covariance.copy()
    for k in bounded:
        if solution[k] * trial.factor.scale[k] > -MAX_NEGLIGIBLE_SHARE * torque:
            reaching = (min(float(solution[k]), 0.0) / width) ** 2
            covariance[k, k] = max(covariance[k, k], reaching)
    while True:
        stds = np.sqrt(np.diag(covariance))
        inside = [
            k
            for k in bounded
            if k not in upper and -_AT_INTERVAL * width * stds[k] <= solution[k] < 0.0
        ]
        if not inside:
            return Bounded(fit, covariance, upper)
        k = min(inside, key=lambda k: solution[k] / stds[k])
        covariance, upper[k] = _truncated(solution, covariance, k, width / CI95_STDS)
        fit = _without(trial, sorted(upper))
        solution = fit.solution


def has_zero_bound(name: str) -> bool:
    """Whether zero is a bound of a parameter that an arm can have."""
    return name == MOTOR_INERTIA or physical_range(name) == "non-negative"


def _truncated(
    solution: FloatArray, covariance: FloatArray, k: int, scale: float
) -> tuple[FloatArray, float]:
    """Covariance about zero of a normal distribution without negative values of one parameter.

    Second, the 95 % quantile of that parameter. `scale` converts standard deviations into those of
    a normal distribution with the same interval.
    """
    std = scale * float(np.sqrt(covariance[k, k]))
    below = -float(solution[k]) / std
    beyond = _NORMAL.cdf(-below)
    # E[(x / std)^2] of x ~ N(-below, 1) std, x > 0
    moment = 1.0 + below**2 - below * _NORMAL.pdf(below) / beyond
    quantile = -_NORMAL.inv_cdf(0.05 * beyond) - below
    row = covariance[k]
    reduced = covariance - (1.0 - moment) / covariance[k, k] * np.outer(row, row)
    return np.asarray(reduced), std * quantile


def _without(trial: Trial, at_zero: list[int]) -> Trial:
    """The trial, fitted without the columns of parameters."""
    shared = trial.equations.shared.copy()
    shared[:, at_zero] = 0.0
    factor = ls.factorise(replace(trial.equations, shared=shared), trial.factor.root)
    return replace(
        trial,
        estimate=replace(trial.estimate, solution=factor.value),
        factor=replace(trial.factor, value=factor.value, common=factor.common, local=factor.local),
    )


_MAX_LAST_CHANGE = 0.5  # last change in standard deviations above which the fit has not converged
_MAX_STICTION_SHARE = 0.3  # share of a record in possible stiction that causes a warning
_MAX_CONDITION_NUMBER = 300.0  # condition number that causes a warning; good motion gives 10 to 50


def warnings_of(best: Trial, variances: FloatArray) -> Iterator[Diagnostic]:
    """Warnings on unidentified parameters, stiction, excitation, convergence and elasticity.

    `variances` (n_parameters,) include the model error.
    """
    columns = best.arm.rigid_columns
    records = Place.in_records(*(s.signals.experiment.name for s in best.stretches))
    for k, column in enumerate(columns):
        if not best.determined[k]:
            place = Place(joint=column.joint, parameter=column.name)
            yield _not_identifiable(best, k, place)
    for joint in best.weighed:
        yield Diagnostic("assumed", Place(joint=joint), "weight", joint=joint)
    for stretch in best.stretches:
        stiction_shares = (stretch.signals.direction == 0.0).mean(axis=0)
        for joint, share in enumerate(stiction_shares.tolist(), start=1):
            if share > _MAX_STICTION_SHARE:
                place = Place.in_records(stretch.signals.experiment.name)
                yield Diagnostic("standing", place, joint=joint, share=share)
    condition = best.factor.condition_number
    if condition > _MAX_CONDITION_NUMBER and best.determined.all():
        weakest_direction = np.abs(best.factor.directions[-1])
        names = tuple(str(columns[k]) for k in np.flatnonzero(weakest_direction > 0.3))
        yield Diagnostic("poor-excitation", records, condition=condition, names=names)
    for k in best.implausible(variances):
        place = Place(joint=columns[k].joint, parameter=columns[k].name)
        value = float(best.solution[k])
        yield Diagnostic("implausible", place, "rigid", value=value, unit=columns[k].unit)
    yield from _cancelling_offsets(best, variances)
    if best.last_move > _MAX_LAST_CHANGE:
        change = best.last_move
        yield Diagnostic("not-settled", records, iterations=MAX_ITERATIONS, change=change)
    limit = best.max_rigid_bandwidth
    if best.bandwidth_hz > limit:
        yield Diagnostic(
            "not-rigid",
            records,
            anti_resonance_hz=RESONANCE_RATIO * limit,
            bandwidth_hz=best.bandwidth_hz,
        )


def _cancelling_offsets(best: Trial, variances: FloatArray) -> Iterator[Diagnostic]:
    """Warn of offsets that only an equal gravity torque can balance."""
    torques = np.array([np.abs(s.signals.motor_torque).max(axis=0) for s in best.stretches])
    width = best.interval_half_width
    for k, column in enumerate(best.arm.rigid_columns):
        if column.name == "friction_offset" and column.joint is not None and best.determined[k]:
            value, largest = float(best.solution[k]), float(torques[:, column.joint - 1].max())
            if abs(value) - width * float(np.sqrt(variances[k])) > largest:
                place, unit = Place(joint=column.joint, parameter=column.name), column.unit
                yield Diagnostic(
                    "implausible", place, "offset", value=value, unit=unit, largest=largest
                )


def _not_identifiable(best: Trial, unknown: int, place: Place) -> Diagnostic:
    """Warn why one parameter is not identifiable, and what to record."""
    columns = best.arm.rigid_columns
    column = columns[unknown]
    joint = column.joint
    motion_directions = [s.signals.direction for s in best.stretches]
    if joint is not None:
        directions = np.concatenate([d[:, joint - 1] for d in motion_directions])
        if not np.any(directions):
            return Diagnostic("not-identifiable", place, "joint-at-rest", joint=joint)
        one_way = not (np.any(directions > 0.0) and np.any(directions < 0.0))
        if one_way and family_of(column.name) == "dry friction":
            return Diagnostic("not-identifiable", place, "one-way", joint=joint)
    joints_at_rest = tuple(
        i + 1
        for i in range(best.arm.n_joints)
        if not any(np.any(d[:, i]) for d in motion_directions)
    )
    if joints_at_rest:
        return Diagnostic("not-identifiable", place, "joints-at-rest", joints=joints_at_rest)
    others = tuple(
        str(columns[k]) for k in ls.companions(best.factor, unknown) if not best.determined[k]
    )
    if others:
        return Diagnostic("not-identifiable", place, "not-separable", others=others)
    return Diagnostic("not-identifiable", place, "no-information")
