"""Evaluation of models on stacked data: innovations, cost and linear least squares."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from strainwave import _core
from strainwave.domain import Diagnostic, FloatArray, SearchEnd, StateSpace
from strainwave.statespace._matrices import ModelMatrices, is_stable, unpack, unscale
from strainwave.statespace._stack import Stack

# Relative variance that regularises the innovations' covariance. It corresponds to innovations of
# 1e-10 of the channel's root mean square, far below the resolution of any sensor, and keeps the
# determinant finite for noise-free data.
MIN_VARIANCE_SHARE = 1e-20

# Innovations that exceed this multiple of the channel's root mean square indicate divergence.
DIVERGENCE_RATIO = 1e3


class Evaluator:
    """Compiled one-step predictor for one data set and one model order."""

    def __init__(self, data: Stack, order: int) -> None:
        self.data = data
        self.order = order
        lengths = list(data.lengths)
        self.core = _core.Innovations(order, data.inputs, data.outputs, lengths)

    def unpack(self, values: FloatArray) -> ModelMatrices:
        """Matrices from a vector in the layout of the core."""
        return unpack(values, self.order, self.data.n_inputs, self.data.n_outputs)

    def residuals(self, matrices: ModelMatrices) -> FloatArray:
        """Scaled innovations (n_samples, n_outputs)."""
        with np.errstate(all="ignore"):
            return self.core.residuals(matrices.pack())

    def cost(self, values: FloatArray) -> float:
        """Cost (N/2) log det of the innovations' covariance; infinite for divergent innovations."""
        residuals = self.core.residuals(values)
        if not np.abs(residuals).max() < DIVERGENCE_RATIO:
            return np.inf
        covariance = limit_covariance(residuals)
        return 0.5 * len(residuals) * float(np.linalg.slogdet(covariance)[1])

    def whitener(self, matrices: ModelMatrices) -> FloatArray:
        """Lower Cholesky factor of the innovations' covariance."""
        return np.asarray(np.linalg.cholesky(limit_covariance(self.residuals(matrices))))

    def linear(
        self,
        matrices: ModelMatrices,
        feedthrough: tuple[bool, ...] | None,
        *,
        gain: bool,
        solutions: int = 2,
    ) -> ModelMatrices:
        """Estimate B, D and the initial states by linear least squares for given A, C and K.

        The innovations are linear in these entries. The first solution weights all outputs equally;
        the second uses the inverse of the innovations' covariance from the first. One solution
        suffices for a starting value. Without `gain`, K is set to zero, so the outputs are
        simulated. If `feedthrough` is None, only the initial states are estimated. Raises
        `LinAlgError` if the predictor overflows.
        """
        if not gain:
            matrices = replace(matrices, K=np.zeros_like(matrices.K))
        if feedthrough is not None:
            matrices = replace(matrices, D=matrices.D * np.array(feedthrough))
        indices = self._linear_entries(feedthrough)
        values = matrices.pack()
        values[indices] = 0.0
        whitener = np.eye(self.data.n_outputs)
        for solution in range(solutions):
            hessian, gradient = self.core.normal_equations(values, whitener)
            # The expansion point stays the same, so a second solution replaces the first.
            block = hessian[np.ix_(indices, indices)]
            if not np.all(np.isfinite(block)):
                raise np.linalg.LinAlgError("the predictor overflows over the record")
            scale = np.sqrt(np.maximum(np.diagonal(block), np.finfo(float).tiny))
            step = np.linalg.lstsq(
                block / np.outer(scale, scale), -gradient[indices] / scale, 1e-14
            )
            values[indices] += step[0] / scale
            if solution + 1 < solutions:
                residuals = self.residuals(self.unpack(values))
                # If the predictor diverges, keep the first solution.
                if not np.abs(residuals).max() < DIVERGENCE_RATIO:
                    break
                whitener = np.asarray(np.linalg.cholesky(limit_covariance(residuals)))
        return self.unpack(values)

    def _linear_entries(self, feedthrough: tuple[bool, ...] | None) -> NDArray[np.intp]:
        n, m, p = self.order, self.data.n_inputs, self.data.n_outputs
        start_b, start_d = n * n, n * (n + m + p)
        states = start_d + p * m + n * p + np.arange(n * len(self.data.lengths))
        if feedthrough is None:
            return states
        D = start_d + np.flatnonzero(np.tile(feedthrough, p))
        return np.concatenate([start_b + np.arange(n * m), D, states])

    def simulated(self, matrices: ModelMatrices) -> FloatArray:
        """Scaled outputs simulated from the inputs, with fitted initial states."""
        with np.errstate(all="ignore"):
            simulator = replace(matrices, K=np.zeros_like(matrices.K))
            if is_stable(simulator.A):
                simulator = self.linear(simulator, None, gain=False, solutions=1)
            return self.data.outputs - self.core.residuals(simulator.pack())


def limit_covariance(residuals: FloatArray) -> FloatArray:
    """Covariance E'E / N, regularised by `MIN_VARIANCE_SHARE`."""
    covariance = residuals.T @ residuals / len(residuals)
    return covariance + MIN_VARIANCE_SHARE * np.eye(len(covariance))


def fit_percent(measured: FloatArray, modelled: FloatArray) -> tuple[float, ...]:
    """Fit 100 (1 - |y - yhat| / |y - mean y|) of each column [%]; -inf if the model diverges."""
    with np.errstate(all="ignore"):
        error_norm = np.linalg.norm(measured - modelled, axis=0)
        signal_norm = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
        fit = 100.0 * (1.0 - error_norm / np.where(signal_norm > 0.0, signal_norm, np.nan))
    return tuple(float(value) if np.isfinite(value) else -np.inf for value in fit)


def assemble(
    data: Stack,
    matrices: ModelMatrices,
    method: Literal["subspace", "pem", "output-error"],
    status: SearchEnd | Literal["estimated", "not-determined"],
    feedthrough: tuple[bool, ...],
    warnings: tuple[Diagnostic, ...] = (),
) -> StateSpace:
    """Result record of a model of scaled channels, in the units of the data."""
    evaluator = Evaluator(data, matrices.order)
    residuals = evaluator.residuals(matrices)
    n, m, p = matrices.order, data.n_inputs, data.n_outputs
    n_gain = 0 if method == "output-error" else n * p
    n_parameters = n * m + n * p + p * sum(feedthrough) + n_gain + n * len(data.lengths)
    samples = data.n_samples
    covariance = limit_covariance(residuals)
    log_scale = samples * float(np.log(data.output_scale).sum())
    cost = 0.5 * samples * float(np.linalg.slogdet(covariance)[1])
    # Degrees of freedom: each output's mean square is reduced by its share of the parameters.
    unbiased = covariance * samples / max(samples - n_parameters / p, 1.0)
    unscaled = unscale(matrices, data)
    return StateSpace(
        A=unscaled.A,
        B=unscaled.B,
        C=unscaled.C,
        D=unscaled.D,
        K=unscaled.K,
        noise_covariance=unbiased * np.outer(data.output_scale, data.output_scale),
        initial_states=unscaled.initial_states,
        sample_time=data.sample_time,
        hold=data.hold,
        method=method,
        status=status,
        fit_percent=fit_percent(data.outputs, evaluator.simulated(matrices)),
        prediction_fit_percent=fit_percent(data.outputs, data.outputs - residuals),
        n_samples=samples,
        n_parameters=n_parameters,
        log_likelihood=-cost - log_scale - 0.5 * samples * p * (1.0 + float(np.log(2.0 * np.pi))),
        input_names=data.input_names,
        output_names=data.output_names,
        warnings=warnings,
    )
