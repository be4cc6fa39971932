"""Link sensors that ring on their mounts, found by evidence in the whole-arm fit.

A mount changes the channels of one sensor and nothing else. What swings in the arm itself moves the
motor as well, and is left to the effects: a mount joins only where, once fitted, it makes its
sensor's residuals much smaller and others' hardly larger.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Parameter
from strainwave.dynamics.link_sensors import is_of_mount, mount_of
from strainwave.dynamics.mount_resonance import MountResonance
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Evaluated
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.identification.whole_arm.residual_analysis import beyond_noise
from strainwave.identification.whole_arm.restricted import is_held
from strainwave.identification.whole_arm.selection import Selection
from strainwave.identification.whole_arm.sensors import with_sensors
from strainwave.identification.whole_arm.solver import fine_search, search_from
from strainwave.numerics.distributions import chi_square_limit

_FREQUENCIES = (30.0, 37.0, 45.0, 55.0, 67.0, 82.0, 100.0, 122.0, 150.0, 183.0, 223.0)  # [Hz]
_DAMPINGS = (0.05, 0.12)  # at each of them
_BEYOND_BAND = 2.0  # times the low-pass's cut-off: beyond, only a quarter is left below it
_FALSE_ALARMS = 1e-4  # odds that noise passes for a mount
_SHARE = 0.1  # of its sensor's cost that a linear step must take off
_STARTS = 3  # mounts from which it is fitted
_TRIAL = 12  # evaluations of each
_GAIN = 0.1  # predicted, at which they end
_LEFT = 0.3  # of its sensor's cost, at most, once it is fitted
_SPOILED = 0.2  # share of what it takes off that, by which the other channels' cost may rise

Names = tuple[Key, Key]
"""Of the frequency and the damping of a sensor's mount."""

Mounts = dict[Names, list[MountResonance]]


def with_ringing_mounts(fit: Fit, selection: Selection) -> Fit:
    """A fit with the mounts of sensors that ring, one after the other.

    Returns: As it is where no sensor's residuals are more than its noise.
    """
    options = selection.options
    while fit.iterations < options.max_iterations and not options.as_published:
        found = _best(fit, selection)
        if found is None:
            break
        selection.grant(found.iterations)
        options = selection.options
        fit = fine_search(found.objective, found.z, fit.iterations + found.iterations, options)
    return fit


def _best(fit: Fit, selection: Selection) -> Fit | None:
    """The fit with the mount that explains most, of those that pass; None where none does."""
    for names, mounts in _promising(fit, selection).items():
        found = _fitted(fit, names, mounts, selection)
        if found is not None and _explains(fit, found, names):
            return found
    return None


def _promising(fit: Fit, selection: Selection) -> Mounts:
    """Mounts whose linear steps are evident, of each sensor the most significant first."""
    tested = _tested(fit, selection)
    n = sum(map(len, tested.values()))
    if not n:
        return {}
    objective = fit.objective.in_long_steps(fit.z)
    values = objective.space.values(fit.z)

    def columns(k: int, _: Evaluated) -> FloatArray:
        record = objective.records[k]
        return record.ringing(values, objective.memory.own[k][: len(record.local)], tested)

    n_unknowns = len(objective.space.unknowns)
    factor = objective.bordered(fit.z, n, columns)[n_unknowns:, n_unknowns:]
    projected, target = factor[:, :-1], factor[:, -1]
    square = np.sum(projected**2, axis=0)
    gains = np.where(projected.T @ target < 0.0, (projected.T @ target) ** 2, 0.0)
    gains /= np.where(square > 0.0, square, np.inf)
    each, limit = iter(gains.tolist()), chi_square_limit(_FALSE_ALARMS / n, 1)
    found: list[tuple[float, Names, list[MountResonance]]] = []
    for names, mounts in tested.items():
        own = sorted(((next(each), mount) for mount in mounts), key=lambda one: -one[0])
        least = max(limit, _SHARE * _cost(fit, names)[0])
        if own[0][0] > least:
            found.append((own[0][0], names, [mount for _, mount in own[:_STARTS]]))
    found.sort(key=lambda one: -one[0])
    return {names: mounts for _, names, mounts in found}


def _tested(fit: Fit, selection: Selection) -> Mounts:
    """Of the sensors whose residuals are more than noise, and that have no mount yet."""
    objective, found = fit.objective, Mounts()
    band = _BEYOND_BAND * max(record.cutoff_hz for record in objective.records)
    known = objective.space.keys
    tested = [MountResonance(f, d) for f in _FREQUENCIES if f < band for d in _DAMPINGS]
    for record, beyond in zip(objective.records, beyond_noise(objective, fit.z), strict=True):
        for channel, more in zip(record.channels, beyond.tolist(), strict=True):
            names = mount_of(channel.sensor, channel.joint)
            if not more or names is None or any(is_held(k, selection.options) for k in names):
                continue
            if names[0] not in known:
                found[names] = tested
    return found


def _fitted(
    fit: Fit, names: Names, mounts: Sequence[MountResonance], selection: Selection
) -> Fit | None:
    """The best of short searches with a mount beside the unknowns, from some resonances."""
    best: Fit | None = None
    values = fit.objective.space.values(fit.z)
    for mount in mounts:
        starts = dict(zip(names, (mount.frequency, mount.damping), strict=True))
        space = with_sensors(fit.objective.space, list(starts), starts)
        objective, begin = fit.objective.for_unknowns(space), space.coordinates(values | starts)
        options = replace(selection.options, max_iterations=_TRIAL)
        try:
            found = search_from(objective, begin, 0, options, tolerance=_GAIN)
        except NotIdentifiable:
            continue
        if best is None or found.cost < best.cost:
            best = found
    return best


def _explains(before: Fit, after: Fit, names: Names) -> bool:
    """Whether a mount explains its sensor's residuals and hardly spoils any other's."""
    (own, others), (left, beside) = (_cost(fit, names) for fit in (before, after))
    return left < _LEFT * own and beside - others < _SPOILED * (own - left)


def _cost(fit: Fit, names: Names) -> tuple[float, float]:
    """Of the channels of a mount's sensor, and of all others."""
    costs = np.zeros(2)
    objective = fit.objective
    every = zip(objective.records, objective.weights, objective.rows(fit.z), strict=True)
    for record, weights, rows in every:
        for channel, cost in zip(record.channels, rows.costs(weights), strict=True):
            costs[0 if mount_of(channel.sensor, channel.joint) == names else 1] += cost
    own, others = costs.tolist()
    return own, others


def mount_warnings(parameters: Sequence[Parameter]) -> Iterator[Diagnostic]:
    """The sensors that ring on their mounts."""
    for found in parameters:
        key = found.name, found.joint
        if not (is_of_mount(key) and found.name.endswith("_frequency")) or found.value is None:
            continue
        sensor = found.name.removesuffix("_mount_frequency").replace("_", " ")
        text = f"the {sensor} of link {found.joint} rings on its mount at {found.value:.3g} ±"
        text += f" {1.96 * (found.std or 0.0):.2g} Hz; estimated and corrected: glue or screw it"
        text += " down"
        yield Diagnostic("sensor-mount", f"joint {found.joint}", text)
