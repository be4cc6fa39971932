"""Rows of one record, weighted by the soft L1 loss.

Columns of the record parameters come first in the least squares problem of a record, so the rows of
its triangular factor below them are the problem in the shared unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.trust_region import Linearised

# maximum updates of the robust weights in the solution for record parameters
_MAX_WEIGHT_UPDATES = 6
# change of residuals, in standard deviations, at which these updates end
_ROBUST_WEIGHT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Weights:
    """Scales of the residuals of a record."""

    stds: FloatArray  # (n_channels,) standard deviations of the residuals
    rows_per_error: FloatArray  # (n_channels,) rows per independent residual


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Unweighted residuals of one record at one point, with derivatives."""

    difference: FloatArray  # (n_rows, n_channels) simulated minus measured
    columns: FloatArray  # (n_rows, n_channels, n_own + n_unknowns): record parameters, then shared
    record_parameters: FloatArray  # (n_own,)

    @property
    def n_own(self) -> int:
        """Number of record parameters."""
        return len(self.record_parameters)

    @property
    def record_columns(self) -> FloatArray:
        """Derivatives with respect to the record parameters: (n_rows, n_channels, n_own)."""
        return self.columns[..., : self.n_own]

    def initial_state_problem(self, weights: Weights) -> Linearised:
        """Cost and least squares problem in the record parameters only."""
        residual = self.difference / weights.stds
        root = np.sqrt(_robust_weight(residual, weights))
        table = np.concatenate(
            [self.record_columns / weights.stds[:, None], residual[..., None]], axis=2
        )
        table = table * root[..., None]
        factor = triangular_factor(table.reshape(-1, table.shape[2]))
        return Linearised(_loss(residual, weights), factor)

    def weigh(self, weights: Weights) -> Rows:
        """Weighted rows, with optimal record parameters."""
        initial_residual = self.difference / weights.stds
        columns = (self.record_columns / weights.stds[:, None]).reshape(initial_residual.size, -1)
        residual, weight = initial_residual, _robust_weight(initial_residual, weights)
        step = np.zeros(self.n_own)
        is_separable = bool(self.n_own) and int(np.count_nonzero(columns, axis=1).max()) == 1
        for _ in range(_MAX_WEIGHT_UPDATES if self.n_own else 0):
            step = _solve_weighted(
                columns, -initial_residual.ravel(), weight.ravel(), is_separable=is_separable
            )
            previous = residual
            residual = initial_residual + (columns @ step).reshape(initial_residual.shape)
            weight = _robust_weight(residual, weights)
            if np.max(np.abs(residual - previous)) < _ROBUST_WEIGHT_TOLERANCE:
                break
        return Rows(residual, np.sqrt(weight), self, weights.stds, step)


@dataclass(frozen=True, slots=True)
class Rows:
    """Weighted rows of one record with optimal record parameters."""

    residual: FloatArray  # (n_rows, n_channels) in standard deviations
    root: FloatArray  # (n_rows, n_channels) square roots of the robust weights
    evaluated: Evaluation
    stds: FloatArray  # (n_channels,)
    step: FloatArray  # (n_own,) of the record parameters to their optimum

    @property
    def errors(self) -> FloatArray:
        """Residuals (n_rows, n_channels) in the units of the channels."""
        return self.residual * self.stds

    @property
    def record_parameters(self) -> FloatArray:
        """Optimal record parameters (n_own,)."""
        return self.evaluated.record_parameters + self.step

    def factor(self, min_curvature_ratio: float) -> FloatArray:
        """R of [shared, residual] after elimination of the record parameters.

        R reproduces the gradient of the loss and its mean curvature. The curvature is less than the
        weights (1 + r^2)^(-1/2) of the gradient, with which steps would be a third too short.
        `min_curvature_ratio` is its minimum relative to the weights.
        """
        square = self.root**2
        curvature = np.sum(square / (1.0 + self.residual**2), axis=0) / np.sum(square, axis=0)
        curvature = np.sqrt(np.maximum(curvature, min_curvature_ratio))
        columns, n = self.evaluated.columns, len(self.step)
        table = np.empty((*self.residual.shape, columns.shape[2] + 1))
        scale = self.root * (curvature / self.stds)
        np.multiply(columns, scale[..., None], out=table[..., :-1])
        np.multiply(self.residual, self.root / curvature, out=table[..., -1])
        return triangular_factor(table.reshape(-1, table.shape[2]))[n:, n:]

    def cost(self, weights: Weights) -> float:
        """Soft L1 loss of the record."""
        return _loss(self.residual, weights)

    def costs(self, weights: Weights) -> FloatArray:
        """Soft L1 loss of each channel, (n_channels,)."""
        return _losses(self.residual, weights)


def _solve_weighted(
    columns: FloatArray, target: FloatArray, weight: FloatArray, *, is_separable: bool
) -> FloatArray:
    """Weighted least squares.

    With `is_separable`, no row has two nonzero columns, and each coefficient is a weighted mean.
    """
    if not is_separable:
        root = np.sqrt(weight)
        return np.asarray(np.linalg.lstsq(columns * root[:, None], target * root)[0])
    weighted = columns * weight[:, None]
    return np.asarray((target @ weighted) / np.einsum("ij,ij->j", columns, weighted))


def _loss(residual: FloatArray, weights: Weights) -> float:
    """Soft L1 loss: sum of 2 (sqrt(1 + r^2) - 1) / rows per independent error."""
    return float(np.sum(_losses(residual, weights)))


def _losses(residual: FloatArray, weights: Weights) -> FloatArray:
    """Soft L1 loss of each channel, (n_channels,)."""
    loss = np.sum(2.0 * (np.sqrt(1.0 + residual**2) - 1.0), axis=0)
    return np.asarray(loss / weights.rows_per_error)


def _robust_weight(residual: FloatArray, weights: Weights) -> FloatArray:
    """Weights (1 + r^2)^(-1/2) / rows per independent error (soft L1 loss)."""
    return np.asarray(1.0 / (np.sqrt(1.0 + residual**2) * weights.rows_per_error))
