"""Warnings about the parameters of a whole-arm fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Parameter, Place
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.domain.link_sensors import is_hidden
from strainwave.domain.parameter_table import SETTLING, VISCOUS
from strainwave.identification.whole_arm.inference.covariance import confidence_of
from strainwave.identification.whole_arm.inference.parameter_estimates import vanished_parameters
from strainwave.identification.whole_arm.search.fit import Fit

_MAX_RELATIVE_STD = 0.1  # relative standard deviation above which a direction is poorly identified
# minimum ratio of marginal to conditional standard deviation for a group to be reported
_MIN_STD_RATIO = 5.0
_MIN_COMPONENT = 0.2  # minimum component of a group member, relative to the largest component
_NOT_REACHED = (
    "not-reached",
    "no record loads the gear so far that it shows; use a larger amplitude, or hold the link",
)
_NOT_APART = (
    "not-identifiable",
    "the records do not show whether the gear bends there; record more motion at small torques",
)


def _curve_reason(place: int, parameters: Sequence[Parameter]) -> tuple[str, str]:
    """Code and text of the reason why a slope or knee has no value.

    A slope or knee at higher torque can have a value.
    """
    parameter = parameters[place]
    has_value_beyond = any(
        p.joint == parameter.joint
        and p.value is not None
        and is_slope(p.name) == is_slope(parameter.name)
        for p in parameters[place + 1 :]
        if is_by_load(p.name)
    )
    return _NOT_APART if has_value_beyond else _NOT_REACHED


def warnings_of(
    fit: Fit, is_at_bound: Sequence[bool], parameters: Sequence[Parameter]
) -> Iterator[Diagnostic]:
    """Yield the warnings about the parameters of a fit.

    `is_at_bound` states for each unknown whether it is at a bound of its range.
    """
    space = fit.space
    values = space.parameters(fit.z)
    stds = np.sqrt(np.diag(confidence_of(fit).combined))
    for k, (unknown, at_bound) in enumerate(zip(space.unknowns, is_at_bound, strict=True)):
        place = Place(joint=unknown.joint, parameter=unknown.name)
        if at_bound and unknown.name != SETTLING:
            text = f"the estimate is at the limit of its range, {values[k]:.3g} {unknown.unit}:"
            text += " the data contradict the model or do not determine the value"
            yield Diagnostic.at("at-bounds", place, text)
        if parameters[k].value is not None:
            continue
        if is_by_load(unknown.name):
            code, text = _curve_reason(k, parameters[: len(space.unknowns)])
            yield Diagnostic.at(code, place, text)
            continue
        message = f"the data give only {values[k]:.3g} +- {stds[k]:.2g} {unknown.unit}"
        if unknown.name in VISCOUS:
            message += "; only the total viscous friction is well determined"
        yield Diagnostic.at("not-identifiable", place, message)
    arm = fit.objective.records[0].arm
    for name, number in vanished_parameters(fit, arm):
        simpler = arm.joints[number - 1].law.simpler
        text = f"the gear is {simpler} within its errors; use a larger amplitude or set"
        yield Diagnostic("not-reached", f"{name} of joint {number}", f'{text} spring = "{simpler}"')
    for unknown, value in zip(space.unknowns, values, strict=True):
        if unknown.name == SETTLING:
            text = f"Coulomb friction reverses over {1e6 * value:.3g} us instead of instantly; the"
            text += " model includes this settling time"
            yield Diagnostic("friction-settles", str(unknown), text)
    combinable = [
        k
        for k, unknown in enumerate(space.unknowns)
        if not is_hidden(unknown.key)
        and unknown.prior_std is None  # deviations from a prior at zero are not combined
    ]
    names = [str(space.unknowns[k]) for k in combinable]
    covariance = confidence_of(fit).combined[np.ix_(combinable, combinable)]
    for group, spread in only_together(names, values[combinable], covariance):
        text = "only a combination of these parameters is identified: they can change together by"
        text += f" {100.0 * spread:.2g} %; use the combination, not the single values"
        yield Diagnostic("only-together", " and ".join(group), text)
    if not fit.converged:
        text = f"the fit did not converge within {fit.iterations} iterations; raise"
        text += " tuning.max_iterations or use longer records"
        yield Diagnostic("iteration-limit", "tuning", text)


def only_together(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> Iterator[tuple[tuple[str, ...], float]]:
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
