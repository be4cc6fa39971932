"""Least squares in a trust region, for problems of many rows and few unknowns.

Each evaluation hands over the triangular factor of its weighted Jacobian with its residual, R of
[J r] = Q R, in which a hundred thousand rows have become as many as there are unknowns. SciPy's
`least_squares` would take a singular value decomposition of all rows at every step, which costs
more than to simulate them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from strainwave.domain import BoolArray, FloatArray

_GOOD, _POOR = 0.75, 0.25  # share of the predicted gain from which the region grows, or shrinks
# Friction's events make a cost rough: below some roughness no predicted gain is to be had.
_PATIENCE = 4  # evaluations without
_STUCK = 30.0  # tolerances of gain, after which the search ends
_HOPE, _LITTLE = 1000.0, 0.2  # unless as many, and this share of the cost, are predicted still
_LOST = 12  # evaluations without, after which nothing predicted is believed: a cliff in the cost
_HELPS = 1e-4  # share from which a step is taken
_LEAST_DAMPING, _FELT = 1e-9, 1e-3  # to which it may fall; to which it rises at once
_SHORTER = 0.3  # share of the last one that is trusted after a step that did not help
_SMALLEST = 1e-12  # of the largest singular value: directions below it are not stepped along


@dataclass(frozen=True, slots=True)
class Linearised:
    """The cost at one point and the least squares problem that stands for it nearby."""

    cost: float
    factor: FloatArray  # (n + 1, n + 1) R of [J r]; the sum of squares is near the cost


class Space(Protocol):
    """Where coordinates may lie, and what is a straight step among them."""

    def moved(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Where a step leads, to first order x + step: (n,)."""

    def bounded(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        """Which coordinates stand at a bound beyond which the cost falls: (n,)."""

    def trusted(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        """The step, cut to the bounds and to a share of what is linear as a rule: (n,)."""


@dataclass(frozen=True, slots=True)
class Flat:
    """Coordinates without bounds, in which every step is straight and may be trusted."""

    def moved(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Their sum."""
        return np.asarray(x + step)

    def bounded(self, x: FloatArray, _: FloatArray) -> BoolArray:
        """None."""
        return np.zeros(len(x), dtype=bool)

    def trusted(self, _x: FloatArray, step: FloatArray, _share: float) -> FloatArray:
        """All of it."""
        return step


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
    space: Space,
    *,
    tolerance: float,
    relative: float = 0.0,
    damping: float = 1e-3,
    max_evaluations: int,
) -> Found | None:
    """Levenberg and Marquardt's method in scaled coordinates, with limits to each step.

    `linearise`: (n,) -> the cost and its least squares problem, or None where there is none.
    `start` (n,).
    `tolerance`: The search has converged when the predicted gain is below this, in units of the
        cost: where residuals are in deviations, a hundredth is a tenth of a parameter's standard
        deviation.
    `relative`: The same as a share of the cost, to be added.
    `damping`: To begin with, beside squared singular values of columns of unit length: small where
        the start is near.
    `max_evaluations`: Of the least squares problem.

    Returns: Not converged if the evaluations ran out, or no step helps although much is predicted.
    None if there is no problem at the start.
    """
    x, first = start, linearise(start)
    if first is None:
        return None
    at = first
    growth, share = 2.0, 1.0
    evaluations = 1
    costs: list[float] = []
    while True:
        free = ~space.bounded(x, at.factor[:, :-1].T @ at.factor[:, -1])
        gain, _ = _step(at.factor, 0.0, free)
        costs.append(at.cost)
        enough = tolerance + relative * at.cost
        if gain < enough:
            return Found(x, at, evaluations, True)
        stalled = len(costs) > _PATIENCE and costs[-_PATIENCE - 1] - at.cost < _STUCK * enough
        lost = len(costs) > _LOST and costs[-_LOST - 1] - at.cost < _STUCK * enough
        hopeless = gain < max(_HOPE * tolerance, _LITTLE * at.cost)
        if lost or (stalled and hopeless):
            return Found(x, at, evaluations, True)
        if evaluations >= max_evaluations:
            return Found(x, at, evaluations, False)
        predicted, step = _trusted_step(at.factor, damping, free, _Trust(space, x, share))
        trial = space.moved(x, step)
        there = linearise(trial)
        evaluations += 1
        quality = (at.cost - there.cost) / max(predicted, 1e-300) if there else -np.inf
        if there is None or quality < _HELPS:
            damping, growth = max(damping * growth, _FELT), growth * 2.0
            share *= _SHORTER
            if abs(predicted) < tolerance:  # no step helps
                return Found(x, at, evaluations, hopeless)
            continue
        if quality > _GOOD:
            damping = max(damping / 5.0, _LEAST_DAMPING)
        elif quality < _POOR:
            damping *= 2.0
        growth, share = 2.0, min(1.0, share / _SHORTER)
        x, at = trial, there


@dataclass(frozen=True, slots=True)
class _Trust:
    """How far a step may go."""

    space: Space
    x: FloatArray
    share: float  # of what is linear as a rule


def _trusted_step(
    factor: FloatArray,
    damping: float,
    free: BoolArray,
    trust: _Trust,
) -> tuple[float, FloatArray]:
    """A damped step in which what would go too far goes as far as it may.

    The others make the best of that: along a narrow valley a step that is merely cut off would
    leave it. What that predicts may be a loss; more damping follows then.
    """
    held = np.zeros(len(free))
    while True:
        predicted, step = _step(factor, damping, free, held)
        cut = trust.space.trusted(trust.x, step, trust.share)
        beyond = free & (cut != step)
        if not np.any(beyond):
            return predicted, step
        held[beyond] = cut[beyond]
        free = free & ~beyond


def _step(
    factor: FloatArray, damping: float, free: BoolArray, held: FloatArray | None = None
) -> tuple[float, FloatArray]:
    """The step that minimises |R (step, 1)|^2 + damping |D step|^2, and the gain it predicts.

    Coordinates that are not free move as `held` says, or not at all.
    """
    R, right = factor[:, :-1], factor[:, -1]
    step = np.zeros(len(free)) if held is None else held.copy()
    if np.any(free):
        scale = np.linalg.norm(R[:, free], axis=0)
        scale[scale == 0.0] = 1.0
        U, s, Vt = np.linalg.svd(R[:, free] / scale, full_matrices=False)
        along = U.T @ (right + R @ step)
        sure = s > _SMALLEST * s[0]
        coefficients = -s[sure] * along[sure] / (s[sure] ** 2 + damping)
        step[free] = Vt[sure].T @ coefficients / scale
    # |right|^2 - |R step + right|^2, without the cancellation
    moved = R @ step
    return float(-np.sum(moved * (2.0 * right + moved))), step
