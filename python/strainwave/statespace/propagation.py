"""From the covariance of a model's entries to that of anything computed from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from strainwave.domain import ContinuousStateSpace, FloatArray, StateSpace

Model = TypeVar("Model", StateSpace, ContinuousStateSpace)

# Share of a standard deviation by which entries are moved: the error of a central difference is
# its square, and the step stays far above rounding for any data with noise.
STEP = 0.01

# Variance of a direction, against the largest in entries of unit variance, that is rounding.
NEGLIGIBLE = 1e-13


def propagate(
    model: Model, function: Callable[[Model], FloatArray], *, stacked: bool = False
) -> tuple[FloatArray, FloatArray | None]:
    """What a function makes of a model, with its covariance by the delta method.

    P_f = J P J', J the derivative of f. The columns of J P^(1/2) are central differences along the
    principal directions of the estimate's scatter, so that changes of coordinates, which the
    covariance does not hold, are never tried.

    `function` (n_values,): It must be smooth near the model, and the same in any coordinates of the
        state.
    `stacked`: The function takes many models at once, as one whose matrices have their number in
        front, and gives (n_models, n_values).

    Returns: `values` (n_values,); `covariance` (n_values, n_values)
    """

    def each(near: Model) -> FloatArray:
        return np.atleast_1d(np.asarray(function(near), dtype=np.float64))

    if model.covariance is None and stacked:
        return function(_moved(model, np.zeros((1, _n_entries(model)))))[0], None
    if model.covariance is None:
        return each(model), None
    steps = STEP * _directions(model.covariance).T
    moves = np.concatenate([np.zeros((1, steps.shape[1])), steps, -steps])
    if stacked:
        found = function(_moved(model, moves))
    else:
        found = np.stack([each(_moved(model, move)) for move in moves])
    J = (found[1 : len(steps) + 1] - found[len(steps) + 1 :]).T / (2.0 * STEP)
    return found[0], J @ J.T


def _directions(covariance: FloatArray) -> FloatArray:
    """S with S S' the covariance; entries have different units, hence its correlations' factor."""
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = np.flatnonzero(std > 0.0)
    if not len(known):
        return np.zeros((len(covariance), 0))
    correlation = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    kept = values > NEGLIGIBLE * values[-1]
    factor = np.zeros((len(covariance), int(kept.sum())))
    factor[known] = std[known, None] * vectors[:, kept] * np.sqrt(values[kept])
    return factor


def _names(model: Model) -> tuple[str, ...]:
    return ("A", "B", "C", "D", "K") if isinstance(model, StateSpace) else ("A", "B", "C", "D")


def _n_entries(model: Model) -> int:
    return sum(getattr(model, name).size for name in _names(model))


def _moved(model: Model, change: FloatArray) -> Model:
    """The model with one change added to its entries, or with many; no covariance."""
    entries, start = {}, 0
    for name in _names(model):
        matrix = getattr(model, name)
        own = change[..., start : start + matrix.size]
        entries[name] = matrix + own.reshape(*change.shape[:-1], *matrix.shape)
        start += matrix.size
    return replace(model, covariance=None, **entries)
