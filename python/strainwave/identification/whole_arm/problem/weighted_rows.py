"""Rows of one record, weighted by the soft L1 loss.

The record parameters are eliminated from the least squares problem of a record. A sensor bias is a
constant in one channel, so its column is projected out directly. Columns of initial states come
first, so the rows of the triangular factor below them are the problem in the shared unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.linalg import triangular_factor, weighted_factor
from strainwave.numerics.search import Linearised
from strainwave.numerics.spectra import rows_per_error

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
    # (n_rows, n_channels, n_initial + n_unknowns): initial states, then shared unknowns
    columns: FloatArray
    record_parameters: FloatArray  # (n_initial + n_biases,)
    biased: tuple[int, ...]  # channels with a bias
    # (n_rows, n_channels) False where rows are zero, because they contain masked samples
    is_counted: BoolArray | None = None
    is_differentiated: bool = True  # False: the columns of the shared unknowns are missing

    def without_derivatives(self) -> Evaluation:
        """The residuals, and the columns of the initial states alone."""
        return replace(
            self, columns=self.columns[..., : self.n_initial].copy(), is_differentiated=False
        )

    @property
    def n_initial(self) -> int:
        """Number of initial states."""
        return len(self.record_parameters) - len(self.biased)

    @property
    def record_columns(self) -> FloatArray:
        """Derivatives with respect to the record parameters: (n_rows, n_channels, n_own)."""
        n = self.n_initial
        columns = np.zeros((*self.difference.shape, len(self.record_parameters)))
        columns[..., :n] = self.columns[..., :n]
        columns[:, self.biased, range(n, columns.shape[2])] = 1.0
        if self.is_counted is not None:
            columns *= self.is_counted[..., None]
        return columns

    def initial_state_problem(self, weights: Weights) -> Linearised:
        """Cost and least squares problem in the record parameters only."""
        residual = self.difference / weights.stds
        root = np.sqrt(_robust_weight(residual, weights))
        table = np.concatenate(
            [self.record_columns / weights.stds[:, None], residual[..., None]], axis=2
        )
        table = table * root[..., None]
        factor = triangular_factor(table.reshape(-1, table.shape[2]))
        return Linearised(float(np.sum(_losses(residual, weights))), factor)

    def weigh(self, weights: Weights) -> Rows:
        """Weighted rows, with optimal record parameters."""
        initial_residual = self.difference / weights.stds
        residual, weight = initial_residual, _robust_weight(initial_residual, weights)
        step = np.zeros(len(self.record_parameters))
        solve = self._solve_biases if self.n_initial == 0 else self._solve_all
        for _ in range(_MAX_WEIGHT_UPDATES if len(step) else 0):
            step, change = solve(initial_residual, weight, weights)
            previous = residual
            residual = initial_residual + change
            weight = _robust_weight(residual, weights)
            if np.max(np.abs(residual - previous)) < _ROBUST_WEIGHT_TOLERANCE:
                break
        return Rows(residual, np.sqrt(weight), self, weights.stds, step)

    def _solve_biases(
        self, residual: FloatArray, weight: FloatArray, weights: Weights
    ) -> tuple[FloatArray, FloatArray]:
        """Step of the biases by weighted means, and the change of the residual by it."""
        if self.is_counted is not None:
            weight = weight * self.is_counted
        total = np.sum(weight, axis=0)
        means = np.sum(weight * residual, axis=0) / np.where(total > 0.0, total, 1.0)
        shift = np.zeros(residual.shape[1])
        shift[list(self.biased)] = -means[list(self.biased)]
        change = np.broadcast_to(shift, residual.shape)
        if self.is_counted is not None:
            change = change * self.is_counted
        return (shift * weights.stds)[list(self.biased)], np.asarray(change)

    def _solve_all(
        self, residual: FloatArray, weight: FloatArray, weights: Weights
    ) -> tuple[FloatArray, FloatArray]:
        """Step of all record parameters by least squares, and the change of the residual by it."""
        columns = (self.record_columns / weights.stds[:, None]).reshape(residual.size, -1)
        root = np.sqrt(weight.ravel())
        step = np.linalg.lstsq(columns * root[:, None], -residual.ravel() * root)[0]
        return np.asarray(step), np.asarray(columns @ step).reshape(residual.shape)

    def remove_biases(self, table: FloatArray, scale: FloatArray) -> None:
        """Project rows onto the complement of the biases' columns, in place.

        `table` (n_rows, n_channels, n) are rows multiplied by `scale` (n_rows, n_channels).
        """
        if self.is_counted is not None:
            scale = scale * self.is_counted
        for channel in self.biased:
            column = scale[:, channel]
            power = column @ column
            if power > 0.0:
                rows = table[:, channel]
                rows -= np.outer(column, (column @ rows) / power)


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

    @property
    def columns(self) -> FloatArray:
        """Weighted columns of initial states and shared unknowns without what biases explain.

        Their shape is (n_rows, n_channels, n_initial + n_unknowns).
        """
        scale = self.root / self.stds
        table = self.evaluated.columns * scale[..., None]
        self.evaluated.remove_biases(table, scale)
        return np.asarray(table)

    @property
    def shared_columns(self) -> FloatArray:
        """Weighted columns of the shared unknowns, orthogonal to the record parameters.

        Their shape is (n_rows, n_channels, n_unknowns).
        """
        table, n = self.columns, self.evaluated.n_initial
        flat = table.reshape(-1, table.shape[2])
        shared = flat[:, n:]
        if n:
            shared = shared - flat[:, :n] @ np.linalg.lstsq(flat[:, :n], shared)[0]
        return np.asarray(shared.reshape(*table.shape[:2], -1))

    def factor(
        self, min_curvature_ratio: float, additional: Sequence[FloatArray] = ()
    ) -> FloatArray:
        """R of [shared, additional, residual] after elimination of the record parameters.

        R reproduces the gradient of the loss and its mean curvature. The curvature is less than the
        weights (1 + r^2)^(-1/2) of the gradient, with which steps would be a third too short.
        `min_curvature_ratio` is its minimum relative to the weights. `additional` are unweighted
        columns (n_rows, n_channels, ...).
        """
        square = self.root**2
        curvature = np.sum(square / (1.0 + self.residual**2), axis=0) / np.sum(square, axis=0)
        curvature = np.sqrt(np.maximum(curvature, min_curvature_ratio))
        columns, n = self.evaluated.columns, self.evaluated.n_initial
        scale = self.root * (curvature / self.stds)
        if self.evaluated.is_counted is not None:
            scale *= self.evaluated.is_counted
        residual = self.residual * (self.root / curvature)
        biased = self.evaluated.biased
        return weighted_factor([columns, *additional], scale, residual, biased)[n:, n:]

    def cost(self, weights: Weights) -> float:
        """Soft L1 loss of the record."""
        return float(np.sum(self.costs(weights)))

    def costs(self, weights: Weights) -> FloatArray:
        """Soft L1 loss of each channel, (n_channels,)."""
        return _losses(self.residual, weights)


def _losses(residual: FloatArray, weights: Weights) -> FloatArray:
    """Sums of 2 (sqrt(1 + r^2) - 1) / rows per independent error by channel: (n_channels,)."""
    loss = np.sum(2.0 * (np.sqrt(1.0 + residual**2) - 1.0), axis=0)
    return np.asarray(loss / weights.rows_per_error)


def _robust_weight(residual: FloatArray, weights: Weights) -> FloatArray:
    """Weights (1 + r^2)^(-1/2) / rows per independent error (soft L1 loss)."""
    return np.asarray(1.0 / (np.sqrt(1.0 + residual**2) * weights.rows_per_error))


def noise_autocovariances(record: Dataset) -> list[FloatArray]:
    """Autocovariance (n_lags,) of each channel's noise for white sensor noise of unit variance.

    The lags are those of rows, from zero.
    """
    each = (record.kernels.taps(slope=channel.reads_angle) for channel in record.channels)
    step = record.kernels.step
    return [
        np.array([taps[: len(taps) - k] @ taps[k:] for k in range(0, len(taps), step)])
        for taps in each
    ]


def filtered_rows_per_error(record: Dataset) -> FloatArray:
    """Rows per independent error (n_channels,) of filtered white noise."""
    return np.array([rows_per_error(lags) for lags in noise_autocovariances(record)])
