"""From the covariance of a model's entries to that of anything computed from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from strainwave.records import ContinuousStateSpace, FloatArray, StateSpace

Model = TypeVar("Model", StateSpace, ContinuousStateSpace)

# Share of a standard deviation by which entries are moved: the error of a central difference is
# its square, and the step stays far above rounding for any data with noise.
STEP = 0.01

# Variance of a direction, against the largest in entries of unit variance, that is rounding.
NEGLIGIBLE = 1e-13


def propagate(
    model: Model, function: Callable[[Model], FloatArray]
) -> tuple[FloatArray, FloatArray | None]:
    """What a function makes of a model, with its covariance by the delta method.

    P_f = J P J', J the derivative of f. The columns of J P^(1/2) are central differences along the
    principal directions of the estimate's scatter, so that changes of coordinates, which the
    covariance does not hold, are never tried.

    Parameters
    ----------
    model : StateSpace or ContinuousStateSpace
    function : model -> (n_values,)
        It must be smooth near the model, and the same in any coordinates of the state.

    Returns
    -------
    values : (n_values,)
    covariance : (n_values, n_values), or None where the model has none
    """
    values = np.atleast_1d(np.asarray(function(model), dtype=np.float64))
    if model.covariance is None:
        return values, None
    J = np.zeros((len(values), 0))
    columns = []
    for ahead, behind in _neighbours(model):
        rise = np.asarray(function(ahead)) - np.asarray(function(behind))
        columns.append(np.atleast_1d(rise) / (2.0 * STEP))
    if columns:
        J = np.column_stack(columns)
    return values, J @ J.T


def _neighbours(model: Model) -> Iterator[tuple[Model, Model]]:
    """Models one step ahead and behind along each principal direction."""
    directions = _directions(np.asarray(model.covariance))
    for direction in STEP * directions.T:
        yield _moved(model, direction), _moved(model, -direction)


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


def _moved(model: Model, change: FloatArray) -> Model:
    """The model with a change added to its entries, and no covariance."""
    names = ("A", "B", "C", "D", "K") if isinstance(model, StateSpace) else ("A", "B", "C", "D")
    entries, start = {}, 0
    for name in names:
        matrix = getattr(model, name)
        entries[name] = matrix + change[start : start + matrix.size].reshape(matrix.shape)
        start += matrix.size
    return replace(model, covariance=None, **entries)
