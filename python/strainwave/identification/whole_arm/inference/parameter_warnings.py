"""Warnings about the parameters of a whole-arm fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    WHOLE_ARM_FIT,
    Clause,
    Diagnostic,
    FloatArray,
    Parameter,
    Place,
    SearchEnd,
)
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.domain.link_sensors import is_hidden
from strainwave.domain.parameter_table import SETTLING, VISCOUS
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.parameter_estimates import (
    vanished_parameters,
)
from strainwave.identification.whole_arm.search.fit import Fit

_Name = TypeVar("_Name")

_MAX_RELATIVE_STD = 0.1  # relative standard deviation above which a direction is poorly identified
# minimum ratio of marginal to conditional standard deviation for a group to be reported
_MIN_STD_RATIO = 5.0
_MIN_COMPONENT = 0.2  # minimum component of a group member, relative to the largest component


def _curve_warning(index: int, parameters: Sequence[Parameter], place: Place) -> Diagnostic:
    """Warn why a slope or knee has no value; one at higher torque can have a value."""
    parameter = parameters[index]
    has_value_beyond = any(
        p.joint == parameter.joint
        and p.value is not None
        and is_slope(p.name) == is_slope(parameter.name)
        for p in parameters[index + 1 :]
        if is_by_load(p.name)
    )
    if has_value_beyond:
        return Diagnostic("not-identifiable", place, "no-bend")
    return Diagnostic("not-reached", place)


def warnings_of(
    fit: Fit, is_at_bound: Sequence[bool], parameters: Sequence[Parameter]
) -> Iterator[Diagnostic]:
    """Yield the warnings about the parameters of a fit.

    `is_at_bound` states for each unknown whether it is at a bound of its range.
    """
    space = fit.space
    values = space.parameters(fit.z)
    stds = np.sqrt(np.diag(confidence_of(fit).combined))
    places = [Place(joint=joint, parameter=name) for name, joint in space.keys]
    rows = zip(space.unknowns, places, is_at_bound, strict=True)
    for k, (unknown, place, at_bound) in enumerate(rows):
        if at_bound and unknown.name != SETTLING:
            value = float(values[k])
            yield Diagnostic("at-bounds", place, value=value, unit=unknown.unit)
        if parameters[k].value is not None:
            continue
        if is_by_load(unknown.name):
            yield _curve_warning(k, parameters[: len(space.unknowns)], place)
            continue
        value, std, unit = float(values[k]), float(stds[k]), unknown.unit
        estimate = Clause("estimate", value=value, std=std, unit=unit)
        split = Clause("viscous-split") if unknown.name in VISCOUS else None
        yield Diagnostic("not-identifiable", place, "whole-arm", estimate=estimate, split=split)
    arm = fit.objective.records[0].arm
    for name, number in vanished_parameters(fit, arm):
        place, law = Place(joint=number, parameter=name), arm.joints[number - 1].law.simpler
        yield Diagnostic("not-reached", place, "simpler-law", law=law)
    for place, value in zip(places, values.tolist(), strict=True):
        if place.parameter == SETTLING:
            yield Diagnostic("friction-settles", place, time=value)
    combinable = [
        k
        for k, unknown in enumerate(space.unknowns)
        if not is_hidden(unknown.key)
        and unknown.prior_std is None  # deviations from a prior at zero are not combined
    ]
    names = [places[k] for k in combinable]
    covariance = confidence_of(fit).combined[np.ix_(combinable, combinable)]
    for group, spread in only_together(names, values[combinable], covariance):
        yield Diagnostic("only-together", group, spread=float(spread))
    if fit.end is SearchEnd.NO_DESCENT:
        yield Diagnostic("no-descent", WHOLE_ARM_FIT)
    elif fit.end is SearchEnd.EVALUATION_LIMIT:
        yield Diagnostic("iteration-limit", WHOLE_ARM_FIT, iterations=fit.iterations)


def only_together(
    names: Sequence[_Name], values: FloatArray, covariance: FloatArray
) -> Iterator[tuple[tuple[_Name, ...], float]]:
    """Yield groups of parameters of which the data identify only a combination.

    `values` is (n,), `covariance` is (n, n). Yields the names of each group, and the relative
    standard deviation of the unidentified combination.
    """
    scale = np.where(values == 0.0, 1.0, np.abs(values))
    relative = covariance / np.outer(scale, scale)
    variances, directions = np.linalg.eigh(relative)
    for variance, direction in zip(variances[::-1], directions.T[::-1], strict=True):
        std = float(np.sqrt(max(variance, 0.0)))
        if std < _MAX_RELATIVE_STD:
            return
        is_member = np.abs(direction) > _MIN_COMPONENT * np.max(np.abs(direction))
        members = np.flatnonzero(is_member)
        if len(members) < 2:
            continue
        # marginal and conditional standard deviation, others unknown and fixed
        information = np.linalg.pinv(relative[np.ix_(members, members)], hermitian=True)
        marginal = np.sqrt(np.diag(relative)[members])
        conditional = 1.0 / np.sqrt(np.diag(information))
        if np.min(marginal / conditional) > _MIN_STD_RATIO:
            yield tuple(names[int(k)] for k in members), std
