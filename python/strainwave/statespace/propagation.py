"""Propagation of a model's covariance to derived quantities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    ContinuousStateSpace,
    FloatArray,
    StateSpace,
)

Model = TypeVar("Model", StateSpace, ContinuousStateSpace)

# Step of the central differences, in standard deviations. Their relative error is about the square
# of the step, and the step is far above rounding for data with noise.
DIFFERENCE_STEP_STDS = 0.01

# Relative eigenvalue of the correlation matrix below which a direction is rounding error.
MIN_EIGENVALUE_RATIO = 1e-13


def propagate(
    model: Model, function: Callable[[Model], FloatArray], *, stacked: bool = False
) -> tuple[FloatArray, FloatArray | None]:
    """Value of a function of a model, and its covariance by the delta method.

    P_f = J P J', where J is the derivative of f. Central differences along the principal directions
    of P give J P^(1/2). The covariance has no component along changes of state coordinates, so
    these are not evaluated.

    `function`: Smooth near the model and invariant to changes of state coordinates; returns
        (n_values,).
    `stacked`: The function accepts a stack of models, whose matrices have a leading axis of length
        n_models, and returns (n_models, n_values).

    Returns values (n_values,) and their covariance (n_values, n_values), or None if the model has
    no covariance.
    """
    n_entries = sum(getattr(model, name).size for name in _names(model))
    steps = np.zeros((0, n_entries))
    if model.covariance is not None:
        steps = DIFFERENCE_STEP_STDS * _directions(model.covariance).T
    changes = np.concatenate([np.zeros((1, n_entries)), steps, -steps])
    if stacked:
        values = function(_with_changes(model, changes))
    else:
        values = np.stack([np.atleast_1d(function(_with_changes(model, c))) for c in changes])
    if model.covariance is None:
        return values[0], None
    J = (values[1 : len(steps) + 1] - values[len(steps) + 1 :]).T / (2.0 * DIFFERENCE_STEP_STDS)
    return values[0], J @ J.T


def _directions(covariance: FloatArray) -> FloatArray:
    """Factor S with S S' = covariance, from the eigenvalues of the correlation matrix.

    The correlation matrix is used because the entries have different units.
    """
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    nonzero = np.flatnonzero(std > 0.0)
    if not len(nonzero):
        return np.zeros((len(covariance), 0))
    correlation = covariance[np.ix_(nonzero, nonzero)] / np.outer(std[nonzero], std[nonzero])
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    is_significant = values > MIN_EIGENVALUE_RATIO * values[-1]
    factor = np.zeros((len(covariance), int(is_significant.sum())))
    roots = np.sqrt(values[is_significant])
    factor[nonzero] = std[nonzero, None] * vectors[:, is_significant] * roots
    return factor


def _names(model: Model) -> tuple[str, ...]:
    return ("A", "B", "C", "D", "K") if isinstance(model, StateSpace) else ("A", "B", "C", "D")


def _with_changes(model: Model, change: FloatArray) -> Model:
    """Model with one change, or a stack of changes, added to its entries; without covariance."""
    entries, start = {}, 0
    for name in _names(model):
        matrix = getattr(model, name)
        part = change[..., start : start + matrix.size]
        entries[name] = matrix + part.reshape(*change.shape[:-1], *matrix.shape)
        start += matrix.size
    return replace(model, covariance=None, **entries)
