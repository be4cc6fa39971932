"""Parameters of a whole-arm fit with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Parameter
from strainwave.domain.arm import unit_in
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.effects import effect_named
from strainwave.domain.gear_laws import is_by_load
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import constant_of
from strainwave.domain.parameter_table import VISCOUS
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.bounds import at_zero
from strainwave.identification.whole_arm.inference.covariance import confidence_of, with_variances
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    effects_in,
    whole_inertia_of,
)
from strainwave.identification.whole_arm.problem.prior import combination
from strainwave.identification.whole_arm.search.fit import Fit

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
        theirs = _covariance(others, confidence_of(model.fit).combined)
        pairs = zip(others, np.diag(theirs).tolist(), strict=True)
        by_key = {other.key: (other.value, square) for other, square in pairs}
        at_own = [(q.value, square) for q, square in zip(quantities, own.tolist(), strict=True)]
        estimates = [by_key.get(q.key, one) for q, one in zip(quantities, at_own, strict=True)]
        shift = np.array(
            [
                0.0 if other is None or value is None else other - value
                for (other, _), (value, _) in zip(estimates, at_own, strict=True)
            ]
        )
        is_determined = [q.key in model.determined for q in quantities]
        of_model = np.where(is_determined, [square for _, square in estimates], own)
        variance = variance + model.weight * of_model
        shifts = shifts + model.weight * np.outer(shift, shift)
    covariance = with_variances(covariance, variance) + shifts
    total = np.diag(covariance)
    stds = np.sqrt(np.where(total >= 0.0, total, np.inf))  # negative only by rounding
    model_stds = np.sqrt(np.diag(shifts))
    zeros = {key for key, at in zip(fit.space.keys, at_zero(fit), strict=True) if at}
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
        for one in effects_in(fit.space, arm)
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
