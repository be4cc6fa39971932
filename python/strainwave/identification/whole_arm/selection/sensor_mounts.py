"""Detection of mount resonances of link sensors in the whole-arm fit.

A mount resonance changes only the channels of its sensor. A resonance of the arm also moves the
motor and is left to the effects. The model therefore includes a mount resonance only if its fit
reduces the residuals of its sensor strongly and increases those of other channels hardly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.distributions import chi_square_limit
from strainwave.domain.keys import Key
from strainwave.dynamics.link_sensors import MountResonance
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.inference.residual_analysis import channels_above_noise
from strainwave.identification.whole_arm.problem.restrictions import is_held
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import fine_search, search_minimum
from strainwave.identification.whole_arm.selection.candidate import Selection
from strainwave.identification.whole_arm.selection.sensor_constants import add_sensor_constants

# natural frequencies [Hz] of the tested mounts
_TESTED_FREQUENCIES_HZ = (30.0, 37.0, 45.0, 55.0, 67.0, 82.0, 100.0, 122.0, 150.0, 183.0, 223.0)
_TESTED_DAMPING_RATIOS = (0.05, 0.12)  # damping ratios of the tested mounts, at each frequency
_MAX_BAND_RATIO = 2.0  # maximum frequency over the cut-off; beyond, at most 1/4 change in the band
_FALSE_ALARM_PROBABILITY = 1e-4  # false alarm probability over all tested mounts
# minimum cost reduction of a linear step, as a share of the sensor's cost
_MIN_LINEAR_COST_SHARE = 0.1
_MAX_STARTS = 3  # starting mounts of a fit
_MAX_TRIAL_EVALUATIONS = 12  # maximum evaluations per start
_TRIAL_TOLERANCE = 0.1  # predicted cost reduction at which a trial ends
_MAX_REMAINING_COST_SHARE = 0.3  # maximum cost of the sensor after the fit, relative to that before
_MAX_SPILLOVER_SHARE = 0.2  # maximum cost increase of other channels, relative to the reduction

Names = tuple[Key, Key]
"""Keys of the frequency and the damping ratio of a sensor's mount."""

Mounts = dict[Names, list[MountResonance]]


def add_mount_resonances(fit: Fit, selection: Selection) -> Fit:
    """Add mount resonances one by one, the most significant first.

    Returns the fit itself if no sensor has residuals above its noise.
    """
    options = selection.options
    while fit.iterations < options.max_iterations:
        best = _best_mount_fit(fit, selection)
        if best is None:
            break
        selection.allow(selection.options.max_iterations + best.iterations)
        best = replace(best, iterations=fit.iterations + best.iterations)
        fit = fine_search(best, selection.options)
    return fit


def _best_mount_fit(fit: Fit, selection: Selection) -> Fit | None:
    """Fit with the most significant acceptable mount; None if there is none."""
    for names, mounts in _significant_mounts(fit, selection).items():
        refit = _fit_mount(fit, names, mounts, selection)
        if refit is not None and _is_acceptable(fit, refit, names):
            return refit
    return None


def _significant_mounts(fit: Fit, selection: Selection) -> Mounts:
    """Mounts with significant score tests, by sensor, the most significant first."""
    tested = _mounts_to_test(fit, selection)
    n = sum(map(len, tested.values()))
    if not n:
        return {}
    objective, values = fit.objective.lengthen_steps(fit.z), fit.values

    def columns(k: int, _: Evaluation) -> FloatArray:
        return objective.records[k].mount_tangent(values, objective.initial_states(k), tested)

    projected, target = objective.project_columns(fit.z, n, columns)
    square = np.sum(projected**2, axis=0)
    gains = np.where(projected.T @ target < 0.0, (projected.T @ target) ** 2, 0.0)
    gains /= np.where(square > 0.0, square, np.inf)
    gain, limit = iter(gains.tolist()), chi_square_limit(_FALSE_ALARM_PROBABILITY / n, 1)
    significant: list[tuple[float, Names, list[MountResonance]]] = []
    for names, mounts in tested.items():
        ranked = sorted(((next(gain), mount) for mount in mounts), key=lambda one: -one[0])
        threshold = max(limit, _MIN_LINEAR_COST_SHARE * _split_cost(fit, names)[0])
        if ranked[0][0] > threshold:
            significant.append((ranked[0][0], names, [mount for _, mount in ranked[:_MAX_STARTS]]))
    significant.sort(key=lambda one: -one[0])
    return {names: mounts for _, names, mounts in significant}


def _mounts_to_test(fit: Fit, selection: Selection) -> Mounts:
    """Mounts to test: of sensors with residuals above noise and without a mount resonance."""
    objective, mounts = fit.objective, Mounts()
    limit_hz = _MAX_BAND_RATIO * max(record.cutoff_hz for record in objective.records)
    present = objective.space.keys
    candidates = [
        MountResonance(f, d)
        for f in _TESTED_FREQUENCIES_HZ
        if f < limit_hz
        for d in _TESTED_DAMPING_RATIOS
    ]
    for record, beyond in zip(
        objective.records, channels_above_noise(objective, fit.z), strict=True
    ):
        for channel, exceeds_noise in zip(record.channels, beyond.tolist(), strict=True):
            names = channel.mount
            if not exceeds_noise or names is None or names[0] in present:
                continue
            if not any(is_held(key, selection.options) for key in names):
                mounts[names] = candidates
    return mounts


def _fit_mount(
    fit: Fit, names: Names, mounts: Sequence[MountResonance], selection: Selection
) -> Fit | None:
    """Best of short searches with a mount as additional unknowns, from several starts."""
    best: Fit | None = None
    for mount in mounts:
        starts = dict(zip(names, (mount.frequency, mount.damping), strict=True))
        space = add_sensor_constants(fit.space, list(starts), starts)
        start = replace(fit.with_unknowns(space, starts), iterations=0)
        options = replace(selection.options, max_iterations=_MAX_TRIAL_EVALUATIONS)
        try:
            trial = search_minimum(start, options, tolerance=_TRIAL_TOLERANCE)
        except NotIdentifiable:
            continue
        if best is None or trial.cost < best.cost:
            best = trial
    return best


def _is_acceptable(before: Fit, after: Fit, names: Names) -> bool:
    """Whether a mount explains the residuals of its sensor without increasing others much."""
    (cost_before, others_before), (cost_after, others_after) = (
        _split_cost(fit, names) for fit in (before, after)
    )
    return (
        cost_after < _MAX_REMAINING_COST_SHARE * cost_before
        and others_after - others_before < _MAX_SPILLOVER_SHARE * (cost_before - cost_after)
    )


def _split_cost(fit: Fit, names: Names) -> tuple[float, float]:
    """Cost of the channels of the mount's sensor, and of all other channels."""
    costs = np.zeros(2)
    objective = fit.objective
    evaluated = zip(objective.records, objective.weights, objective.rows(fit.z), strict=True)
    for record, weights, rows in evaluated:
        for channel, cost in zip(record.channels, rows.costs(weights), strict=True):
            costs[0 if channel.mount == names else 1] += cost
    sensor_cost, others = costs.tolist()
    return sensor_cost, others
