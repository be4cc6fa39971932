"""A fit -> parameters with their intervals, and what must be said of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Parameter
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.domain.parameters import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import is_hidden, is_mounting, reported
from strainwave.identification.whole_arm.covariance import Confidence, confidence_of, only_together
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.parametrisation import (
    SETTLING,
    VISCOUS,
    Key,
    combination,
)

_IDENTIFIED = 0.3  # relative deviation up to which a parameter is worth printing
_OFF = 1e-6  # by which a mounting's unknowns are varied for slopes
_REACH = 1.96  # of a 95 % interval, in deviations
_NOT_REACHED = (
    "not-reached",
    "no record loads the gear so far that it shows; use a larger amplitude, or hold the link",
)
_NOT_APART = (
    "not-identifiable",
    "the records do not show whether the gear bends there; record more motion at small torques",
)


@dataclass(frozen=True)
class Fit:
    """Where the search ended."""

    objective: Objective
    z: FloatArray  # (n_unknowns,)
    cost: float  # by the weights of the search; infinite before any
    iterations: int
    converged: bool

    @property
    def records(self) -> list[str]:
        """Names of the records."""
        return [record.log.name for record in self.objective.records]

    @cached_property
    def confidence(self) -> Confidence:
        """How sure the unknowns are."""
        return confidence_of(self.objective, self.z)


def parameters_of(
    fit: Fit, arm: Arm, largest_torque: Sequence[float]
) -> tuple[tuple[Parameter, ...], FloatArray]:
    """The unknowns and what is derived from them, with their covariance.

    Parameters
    ----------
    fit : Fit
    arm : Arm
    largest_torque : sequence of float [N m]
        That each gear carries in the records.

    Returns
    -------
    tuple of Parameter, (n_parameters, n_parameters)
    """
    space = fit.objective.space
    keys = space.keys
    names = list(keys)
    units = [unknown.unit for unknown in space.unknowns]
    identified = _identified_curves(fit, fit.confidence.combined, arm, largest_torque)
    weight = [combination(keys, {identified.get(key) or key: 1.0}) for key in keys]
    held = [0.0] * len(keys)
    for (name, number), parts in arm.reported.items():
        if number is None or not any(key in keys for key in parts):
            continue  # all of it is held
        names.append((name, number))
        units.append(unit_of(name, arm.joints[number - 1]))
        weight.append(combination(keys, parts))
        held.append(sum(w * space.fixed.get(key, 0.0) for key, w in parts.items()))
    for name, number in _vanished(fit, arm):
        names.append((name, number))
        units.append(unit_of(name, arm.joints[number - 1]))
        weight.append(combination(keys, {}))
        held.append(0.0)
        identified[name, number] = None
    W = np.array(weight)
    values = W @ space.parameters(fit.z) + np.array(held)
    mounted = mountings_of(fit)
    if mounted.names:
        names += mounted.names
        units += mounted.units
        W = np.vstack([W, mounted.slopes])
        values = np.concatenate([values, mounted.values])
    covariance = W @ fit.confidence.combined @ W.T
    variance = np.diag(covariance)
    deviation = np.sqrt(np.where(variance >= 0.0, variance, np.inf))  # below only by rounding
    deviation[[identified.get(name, name) is None for name in names]] = np.inf
    found = tuple(
        _parameter(name, joint, unit, float(value), float(std))
        for (name, joint), unit, value, std in zip(names, units, values, deviation, strict=True)
    )
    return found, covariance


@dataclass(frozen=True, slots=True)
class Mountings:
    """Places and attitudes of IMUs, as functions of the unknowns."""

    names: list[Key]
    units: list[str]
    values: FloatArray  # (n,)
    slopes: FloatArray  # (n, n_unknowns)


def mountings_of(fit: Fit) -> Mountings:
    """What a reader wants to know of IMUs whose mounting is unknown, linearised at the minimum.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    Mountings
        Empty where there is none.
    """
    space = fit.objective.space
    keys, at = space.keys, space.values(fit.z)
    arm = fit.objective.records[0].arm
    axes = dict.fromkeys(
        c.axis for r in fit.objective.records for c in r.channels if c.axis is not None
    )
    hidden = [k for k, key in enumerate(keys) if is_mounting(key)]
    found = Mountings([], [], np.zeros(0), np.zeros((0, len(keys))))
    for joint in dict.fromkeys(axis.joint for axis in axes):
        own = [axis for axis in axes if axis.joint == joint]
        here = reported(own, arm, at)
        slopes = np.zeros((len(here), len(keys)))
        for k in hidden:
            ends = [reported(own, arm, {**at, keys[k]: at[keys[k]] + off}) for off in (_OFF, -_OFF)]
            for row, (name, (_, unit)) in enumerate(here.items()):
                gap = ends[0][name][0] - ends[1][name][0]
                if unit == "rad":
                    gap = float(np.arctan2(np.sin(gap), np.cos(gap)))
                slopes[row, k] = gap / (2.0 * _OFF)
        found = Mountings(
            [*found.names, *((name, joint) for name in here)],
            [*found.units, *(unit for _, unit in here.values())],
            np.concatenate([found.values, [value for value, _ in here.values()]]),
            np.vstack([found.slopes, slopes]),
        )
    return found


def _vanished(fit: Fit, arm: Arm) -> Iterator[tuple[str, int]]:
    """Parameters of gears that a fit does without."""
    for number, joint in enumerate(arm.joints, start=1):
        for name in joint.law.may_vanish:
            if fit.objective.space.fixed.get((name, number)) == 0.0:
                yield name, number


def _identified_curves(
    fit: Fit, covariance: FloatArray, arm: Arm, largest_torque: Sequence[float]
) -> dict[Key, Key | None]:
    """For each parameter of a curve the unknown that holds it; None where no record reaches it."""
    space = fit.objective.space
    at = {key: k for k, key in enumerate(space.keys)}
    values = space.values(fit.z)
    identified: dict[Key, Key | None] = {}
    pairs = zip(arm.joints, largest_torque, strict=True)
    for number, (joint, largest) in enumerate(pairs, start=1):
        own = [at[name, number] for name in joint.law.names if (name, number) in at]
        if len(own) < len(joint.law.names):
            continue
        known = joint.law.of_joint(values, number)
        found = joint.law.identified(known, covariance[np.ix_(own, own)], largest)
        identified |= {
            (name, number): None if by is None else (by, number) for name, by in found.items()
        }
    return identified


def _parameter(name: str, joint: int | None, unit: str, value: float, std: float) -> Parameter:
    may_be_vague = name in VISCOUS or is_by_load(name)
    vague = may_be_vague and std > _IDENTIFIED * abs(value)
    if vague or not np.isfinite(std):
        return Parameter(name, joint, None, None, unit, "tuned")
    reach = _REACH * std
    return Parameter(name, joint, value, std, unit, "tuned", (value - reach, value + reach))


def _of_curve(place: int, parameters: Sequence[Parameter]) -> tuple[str, str]:
    """Why a slope or a knee has no value: code and text. What lies beyond may have one."""
    own = parameters[place]
    beyond = any(
        p.joint == own.joint and p.value is not None and is_slope(p.name) == is_slope(own.name)
        for p in parameters[place + 1 :]
        if is_by_load(p.name)
    )
    return _NOT_APART if beyond else _NOT_REACHED


def warnings_of(
    fit: Fit, bounded: Sequence[bool], parameters: Sequence[Parameter]
) -> Iterator[Diagnostic]:
    """What a reader of the parameters must know.

    Parameters
    ----------
    fit : Fit
    bounded : sequence of bool
        Of each unknown, whether it ended at the end of its range.
    parameters : sequence of Parameter

    Yields
    ------
    Diagnostic
    """
    space = fit.objective.space
    values = space.parameters(fit.z)
    deviation = np.sqrt(np.diag(fit.confidence.combined))
    for k, (unknown, at) in enumerate(zip(space.unknowns, bounded, strict=True)):
        if at and unknown.name != SETTLING:
            text = f"the fit ended at the end of its range, {values[k]:.3g} {unknown.unit}: the"
            text += " records do not agree on it"
            yield Diagnostic("at-bounds", str(unknown), text)
        if parameters[k].value is not None:
            continue
        if is_by_load(unknown.name):
            code, text = _of_curve(k, parameters[: len(space.unknowns)])
            yield Diagnostic(code, str(unknown), text)
            continue
        said = (
            f"the records identify it only to {values[k]:.3g} +- {deviation[k]:.2g} {unknown.unit}"
        )
        if unknown.name in VISCOUS:
            said += "; of the viscous frictions only the total is well known"
        yield Diagnostic("not-identifiable", str(unknown), said)
    arm = fit.objective.records[0].arm
    for name, number in _vanished(fit, arm):
        simpler = arm.joints[number - 1].law.simpler
        text = f"in every record the gear is as good as {simpler}; use a larger amplitude, or give"
        yield Diagnostic("not-reached", f"{name} of joint {number}", f'{text} spring = "{simpler}"')
    for unknown, value in zip(space.unknowns, values, strict=True):
        if unknown.name == SETTLING:
            text = f"friction takes {1e6 * value:.3g} us to bring the motor to rest, not nothing:"
            text += " it changes sides that much before the motor does"
            yield Diagnostic("friction-settles", str(unknown), text)
    shown = [
        k
        for k, unknown in enumerate(space.unknowns)
        if not is_hidden(unknown.key) and unknown.prior_std is None  # beside that their zero counts
    ]
    names = [str(space.unknowns[k]) for k in shown]
    covariance = fit.confidence.combined[np.ix_(shown, shown)]
    for group, spread in only_together(names, values[shown], covariance):
        text = "only the combination is identified: the values trade off by"
        text += f" {100.0 * spread:.2g} %; trust it, not each value"
        yield Diagnostic("only-together", " and ".join(group), text)
    if not fit.converged:
        text = f"still moving after {fit.iterations} iterations; allow more, or record longer"
        yield Diagnostic("iteration-limit", "tuning", text)
