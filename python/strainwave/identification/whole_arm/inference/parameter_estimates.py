"""Parameters of a whole-arm fit with confidence intervals, and warnings about them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import is_by_load, is_slope
from strainwave.domain.arm.link_sensors import constant_of, is_hidden
from strainwave.domain.arm.parameter_table import SETTLING, VISCOUS
from strainwave.domain.keys import Key
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_of, with_variances
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    effects_among,
    whole_inertia_of,
)
from strainwave.identification.whole_arm.problem.parameter_space import combination
from strainwave.identification.whole_arm.search import Fit

# maximum relative standard deviation of a published viscous friction, slope or knee
_MAX_RELATIVE_STD = 0.3
_MOUNTING_STEPS = (1e-6, -1e-6)  # of mounting unknowns for central differences [m or rad]


@dataclass(frozen=True, slots=True)
class PlausibleModel:
    """A model that predicts held-out stretches about as well as the one that is handed over."""

    fit: Fit
    arm: Arm
    weight: float  # by held-out scores
    determined: frozenset[Key]  # parameters; of others, only their shifts count


def parameters_of(
    fit: Fit,
    arm: Arm,
    largest_torque: Sequence[float],
    plausible: Sequence[PlausibleModel] = (),
    excess: Mapping[Key, float] | None = None,
) -> tuple[tuple[Parameter, ...], FloatArray]:
    """Compute the unknowns and derived parameters, with their covariance.

    With the weights w of the models, V = sum w [P + (theta_m - theta)(theta_m - theta)'] about the
    model that is handed over; the second part is the model error. `excess` has further variances of
    the model error. `largest_torque` [N m] is the largest torque of each gear in the records. The
    covariance is (n_parameters, n_parameters).
    """
    quantities = _quantities(fit, arm, largest_torque)
    covariance = _covariance(quantities, confidence_of(fit).combined)
    own = np.diag(covariance)
    variance = (1.0 - sum(model.weight for model in plausible)) * own
    shifts = np.diag([(excess or {}).get(quantity.key, 0.0) for quantity in quantities])
    for model in plausible:
        others = _quantities(model.fit, model.arm, largest_torque)
        squares = np.diag(_covariance(others, confidence_of(model.fit).combined)).tolist()
        estimates = {q.key: (q.value, square) for q, square in zip(others, squares, strict=True)}
        shift, of_model = np.zeros(len(quantities)), own.copy()
        for k, q in enumerate(quantities):
            value, square = estimates.get(q.key, (None, own[k]))
            if value is not None and q.value is not None:
                shift[k] = value - q.value
            if q.key in model.determined:
                of_model[k] = square
        variance = variance + model.weight * of_model
        shifts = shifts + model.weight * np.outer(shift, shift)
    covariance = with_variances(covariance, variance) + shifts
    total = np.diag(covariance)
    stds = np.sqrt(np.where(total >= 0.0, total, np.inf))  # negative only by rounding
    model_stds = np.sqrt(np.diag(shifts))
    zeros = {key for key, at in zip(fit.space.keys, fit.at_zero, strict=True) if at}
    rows = zip(quantities, stds.tolist(), model_stds.tolist(), strict=True)
    return tuple(_parameter(q, std, model, q.key in zeros) for q, std, model in rows), covariance


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A parameter of the result as a function of the unknowns, linearised at the minimum."""

    key: Key
    unit: str
    value: float | None  # None: not identified
    slope: FloatArray  # (n_unknowns,)


def _quantities(fit: Fit, arm: Arm, largest_torque: Sequence[float]) -> list[_Quantity]:
    curves = identified_curves(fit, confidence_of(fit).combined, arm, largest_torque)
    return [
        *_unknowns(fit, arm, curves),
        *_combinations(fit, arm),
        *(
            _Quantity(key, unit_in(arm, key), None, np.zeros(len(fit.z)))
            for key in vanished_parameters(fit, arm)
        ),
        *_mountings(fit),
    ]


def _covariance(quantities: Sequence[_Quantity], of_unknowns: FloatArray) -> FloatArray:
    W = np.array([quantity.slope for quantity in quantities])
    return np.asarray(W @ of_unknowns @ W.T)


def _unknowns(fit: Fit, arm: Arm, identified: Mapping[Key, Key | None]) -> Iterator[_Quantity]:
    """The unknowns, but not those that stand for a combination of parameters of links.

    `identified` maps curve parameters to the unknowns that have their values.
    """
    keys, values = fit.space.keys, fit.values
    combined = {*arm.base.independent_links} - {*arm.base.separate_links}
    for unknown in fit.space.unknowns:
        if arm.base.has_groups and unknown.key in combined:
            continue
        source = identified.get(unknown.key, unknown.key)
        slope = combination(keys, {source or unknown.key: 1.0})
        value = None if source is None else values[source]
        yield _Quantity(unknown.key, unknown.unit, value, slope)


def _combinations(fit: Fit, arm: Arm) -> Iterator[_Quantity]:
    """Reported combinations with at least one unknown; those of slow motion have parts of links."""
    keys, values = fit.space.keys, fit.values
    flexible: dict[Key, Key] = {
        whole: (effect_named(one[1]).sizes[0], one[0])
        for one in effects_among(fit.space.keys, arm.n_joints)
        if (whole := whole_inertia_of(one, arm))
    }
    for (name, number), own in arm.reported.items():
        parts = dict(own)
        if (name, number) in arm.lumped_inertias:
            parts |= {flexible[key]: weight for key, weight in own.items() if key in flexible}
        if number is not None and any(key in keys for key in parts):
            value = sum(weight * values.get(key, 0.0) for key, weight in parts.items())
            unit = unit_in(arm, (name, number))
            yield _Quantity((name, number), unit, value, combination(keys, parts))


def _mountings(fit: Fit) -> Iterator[_Quantity]:
    """Position and attitude of IMUs with unknown mounting."""
    keys, values = fit.space.keys, fit.values
    channels = (channel for record in fit.objective.records for channel in record.channels)
    axes = dict.fromkeys(channel for channel in channels if channel.is_mounted)
    hidden = [k for k, key in enumerate(keys) if (one := constant_of(key)) and one.is_mounting]
    for joint in dict.fromkeys(axis.joint for axis in axes):
        sensor_axes = [axis for axis in axes if axis.joint == joint]
        report = partial(sensor_axes[0].sensor.report, sensor_axes)
        ends = {
            k: [report({**values, keys[k]: values[keys[k]] + step}) for step in _MOUNTING_STEPS]
            for k in hidden
        }
        for name, (value, unit) in report(values).items():
            slope = np.zeros(len(keys))
            for k, (upper, lower) in ends.items():
                difference = upper[name][0] - lower[name][0]
                if unit == "rad":
                    difference = float(np.arctan2(np.sin(difference), np.cos(difference)))
                slope[k] = difference / (_MOUNTING_STEPS[0] - _MOUNTING_STEPS[1])
            yield _Quantity((name, joint), unit, value, slope)


def parameters_at_bounds(fit: Fit, arm: Arm) -> Iterator[Key]:
    """Yield the parameters at a bound, and the inertias that contain them, as (name, joint).

    The total viscous friction of a joint is omitted, because it can be identifiable although its
    parts are not.
    """
    pairs = zip(fit.space.keys, fit.at_bounds, strict=True)
    ended = [key for key, at in pairs if at and key[0] != SETTLING]
    yield from ended
    links = {key: row for key, row in arm.reported.items() if key[0] == "link_inertia"}
    for key, parts in (*arm.lumped_inertias.items(), *links.items()):
        if key not in ended and any(part in ended for part in parts):
            yield key


def vanished_parameters(fit: Fit, arm: Arm) -> Iterator[tuple[str, int]]:
    """Yield gear parameters that the fit fixes to zero."""
    for number, joint in enumerate(arm.joints, start=1):
        for name in joint.law.may_vanish:
            if fit.space.fixed.get((name, number)) == 0.0:
                yield name, number


def identified_curves(
    fit: Fit, covariance: FloatArray, arm: Arm, largest_torque: Sequence[float]
) -> dict[Key, Key | None]:
    """Map each curve parameter to its unknown, or to None if no record reaches its torque."""
    space = fit.space
    at = {key: k for k, key in enumerate(space.keys)}
    values = space.values(fit.z)
    identified: dict[Key, Key | None] = {}
    pairs = zip(arm.joints, largest_torque, strict=True)
    for number, (joint, largest) in enumerate(pairs, start=1):
        columns = [at[name, number] for name in joint.law.names if (name, number) in at]
        if len(columns) < len(joint.law.names):
            continue
        curve = joint.law.of_joint(values, number)
        sources = joint.law.identified(curve, covariance[np.ix_(columns, columns)], largest)
        identified |= {
            (name, number): None if source is None else (source, number)
            for name, source in sources.items()
        }
    return identified


def _parameter(quantity: _Quantity, std: float, model_std: float, is_zero: bool) -> Parameter:
    key, value, unit = quantity.key, quantity.value, quantity.unit
    may_be_vague = key[0] in VISCOUS or is_by_load(key[0])
    is_vague = may_be_vague and (is_zero or std > _MAX_RELATIVE_STD * abs(value or 0.0))
    if value is None or is_vague or not np.isfinite(std):
        return Parameter(*key, None, None, unit, "tuned")
    estimate = Parameter.estimated(key, value, std, unit, "tuned")
    if is_zero:
        estimate = Parameter.at_zero(key, value + CI95_STDS * std, unit, "tuned")
    return replace(estimate, model_std=model_std or None)


_Name = TypeVar("_Name")

_MAX_DIRECTION_STD = 0.1  # relative standard deviation above which a direction is poorly identified
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


def warnings_of(fit: Fit, parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """Yield the warnings about the parameters of a fit."""
    space = fit.space
    values = space.parameters(fit.z)
    stds = np.sqrt(np.diag(confidence_of(fit).combined))
    places = [Place(joint=joint, parameter=name) for name, joint in space.keys]
    rows = zip(space.unknowns, places, fit.at_bounds, strict=True)
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
        if std < _MAX_DIRECTION_STD:
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
