"""Least squares in a trust region, for problems of many rows and few unknowns.

Each evaluation hands over the triangular factor of its weighted Jacobian with its residual, R of
[J r] = Q R, in which a hundred thousand rows have become as many as there are unknowns. SciPy's
`least_squares` would take a singular value decomposition of all rows at every step, which costs
more than to simulate them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from strainwave.records import FloatArray

_GOOD, _POOR = 0.75, 0.25  # share of the foretold gain from which the region grows, or shrinks
# Friction's events make a cost rough: below some roughness no foretold gain is to be had.
_PATIENCE = 4  # evaluations without
_STUCK = 30.0  # tolerances of gain, after which the search ends
_HOPE = 1000.0  # unless as many are foretold still
_LOST = 12  # evaluations without, after which nothing foretold is believed: a cliff in the cost
_HELPS = 1e-4  # share from which a step is taken
_LEAST_DAMPING, _FELT = 1e-9, 1e-3  # to which it may fall; to which it rises at once
_SMALLEST = 1e-12  # of the largest singular value: directions below it are not stepped along


@dataclass(frozen=True, slots=True)
class Linearised:
    """The cost at one point and the least squares problem that stands for it nearby."""

    cost: float
    factor: FloatArray  # (n + 1, n + 1) R of [J r]; the sum of squares is near the cost


@dataclass(frozen=True, slots=True)
class Found:
    """Where the search ended."""

    x: FloatArray  # (n,)
    at: Linearised
    evaluations: int
    converged: bool


def minimise(
    linearise: Callable[[FloatArray], Linearised | None],
    start: FloatArray,
    reach: FloatArray,
    *,
    tolerance: float,
    relative: float = 0.0,
    farthest: float = np.inf,
    damping: float = 1e-3,
    max_evaluations: int,
) -> Found | None:
    """Levenberg and Marquardt's method in scaled coordinates, with bounds on each.

    Parameters
    ----------
    linearise : callable
        (n,) -> the cost and its least squares problem, or None where there is none.
    start : (n,)
    reach : (n,)
        Bounds are minus and plus this.
    tolerance : float
        The search has converged when the foretold gain is below this, in units of the cost: where
        residuals are in deviations, a hundredth is a tenth of a parameter's standard deviation.
    relative : float
        The same as a share of the cost, to be added.
    farthest : float
        Step of a coordinate beyond which nothing linear is to be trusted.
    damping : float
        To begin with, beside squared singular values of columns of unit length: small where the
        start is near.
    max_evaluations : int
        Of the least squares problem.

    Returns
    -------
    Found
        Not converged if the evaluations ran out, or no step helps although much is foretold. None
        if there is no problem at the start.
    """
    x, first = start, linearise(start)
    if first is None:
        return None
    at = first
    growth = 2.0
    evaluations = 1
    costs: list[float] = []
    while True:
        bounded = _pushed_out(x, reach, at.factor)
        gain, _ = _step(at.factor, 0.0, bounded)
        costs.append(at.cost)
        enough = tolerance + relative * at.cost
        if gain < enough:
            return Found(x, at, evaluations, True)
        stalled = len(costs) > _PATIENCE and costs[-_PATIENCE - 1] - at.cost < _STUCK * enough
        lost = len(costs) > _LOST and costs[-_LOST - 1] - at.cost < _STUCK * enough
        if lost or (stalled and gain < _HOPE * enough):
            return Found(x, at, evaluations, True)
        if evaluations >= max_evaluations:
            return Found(x, at, evaluations, False)
        foretold, step = _step(at.factor, damping, bounded)
        step = np.clip(step, -farthest, farthest)
        trial = np.asarray(np.clip(x + step, -reach, reach))
        there = linearise(trial)
        evaluations += 1
        quality = (at.cost - there.cost) / max(foretold, 1e-300) if there else -np.inf
        if there is None or quality < _HELPS:
            damping, growth = max(damping * growth, _FELT), growth * 2.0
            if foretold < tolerance:  # no step helps
                return Found(x, at, evaluations, gain < _HOPE * enough)
            continue
        if quality > _GOOD:
            damping = max(damping / 5.0, _LEAST_DAMPING)
        elif quality < _POOR:
            damping *= 2.0
        growth = 2.0
        x, at = trial, there


def _step(factor: FloatArray, damping: float, bounded: FloatArray) -> tuple[float, FloatArray]:
    """The step that minimises |R (step, 1)|^2 + damping |D step|^2, and the gain it foretells."""
    free = ~bounded.astype(bool)
    R, right = factor[:, :-1][:, free], factor[:, -1]
    scale = np.linalg.norm(R, axis=0)
    scale[scale == 0.0] = 1.0
    U, s, Vt = np.linalg.svd(R / scale, full_matrices=False)
    along = U.T @ right
    sure = s > _SMALLEST * s[0]
    s, along, Vt = s[sure], along[sure], Vt[sure]
    coefficients = -s * along / (s**2 + damping)
    step = np.zeros(len(bounded))
    step[free] = Vt.T @ coefficients / scale
    gain = -np.sum(coefficients * (2.0 * s * along + s**2 * coefficients))
    return float(gain), step


def _pushed_out(x: FloatArray, reach: FloatArray, factor: FloatArray) -> FloatArray:
    """Which coordinates stand at a bound and would go beyond it: the gradient points outward."""
    gradient = factor[:, :-1].T @ factor[:, -1]
    return np.asarray((np.abs(x) >= reach) & (np.sign(x) * gradient < 0.0))
