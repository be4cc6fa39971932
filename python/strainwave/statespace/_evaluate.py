"""Models on stacked data: innovations, cost, and the entries that enter linearly."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from strainwave import _core
from strainwave.domain import Diagnostic, FloatArray, StateSpace
from strainwave.statespace._entries import Matrices, unpack, unscale
from strainwave.statespace._riccati import is_stable
from strainwave.statespace._stack import Stack

# Innovations below 1e-10 of their channel's root mean square are rounding, far under any sensor's
# resolution: the determinant of exact data stays finite.
FLOOR = 1e-20

# Innovations this many times their channel's root mean square are those of no model.
DIVERGED = 1e3


class Evaluator:
    """The compiled predictor over one stack of data, for models of one order."""

    def __init__(self, data: Stack, order: int) -> None:
        self.data = data
        self.order = order
        lengths = list(data.lengths)
        self.core = _core.Innovations(order, data.inputs, data.outputs, lengths)

    def unpack(self, values: FloatArray) -> Matrices:
        """From the core's vector."""
        return unpack(values, self.order, self.data.n_inputs, self.data.n_outputs)

    def residuals(self, matrices: Matrices) -> FloatArray:
        """(n_samples, n_outputs) innovations, scaled."""
        with np.errstate(all="ignore"):
            return self.core.residuals(matrices.pack())

    def cost(self, values: FloatArray) -> float:
        """(N/2) log det of the innovations' covariance; infinite where they diverge."""
        residuals = self.core.residuals(values)
        if not np.abs(residuals).max() < DIVERGED:
            return np.inf
        covariance = floored_covariance(residuals)
        return 0.5 * len(residuals) * float(np.linalg.slogdet(covariance)[1])

    def whitener(self, matrices: Matrices) -> FloatArray:
        """Lower factor of the innovations' covariance."""
        return np.asarray(np.linalg.cholesky(floored_covariance(self.residuals(matrices))))

    def linear(
        self,
        matrices: Matrices,
        feedthrough: tuple[bool, ...] | None,
        *,
        gain: bool,
        solutions: int = 2,
    ) -> Matrices:
        """B, D and the initial states by least squares over the whole record, A, C, K given.

        The innovations are linear in them. The first solution weighs the outputs alike, the second
        by the covariance that the first left; for a start one will do. Without `gain`, K is set to
        zero and the outputs are simulated; without `feedthrough`, only the initial states are
        estimated. A predictor that overflows over the record is a `LinAlgError`: nothing can be
        said of its entries, and with none it would pass for a model of no inputs.
        """
        if not gain:
            matrices = replace(matrices, K=np.zeros_like(matrices.K))
        if feedthrough is not None:
            matrices = replace(matrices, D=matrices.D * np.array(feedthrough))
        chosen = self._linear_entries(feedthrough)
        values = matrices.pack()
        values[chosen] = 0.0
        whitener = np.eye(self.data.n_outputs)
        for solution in range(solutions):
            hessian, gradient = self.core.normal_equations(values, whitener)
            # Fresh from the same point, so that a second solution replaces the first.
            block = hessian[np.ix_(chosen, chosen)]
            if not np.all(np.isfinite(block)):
                raise np.linalg.LinAlgError("the predictor overflows over the record")
            scale = np.sqrt(np.maximum(np.diagonal(block), np.finfo(float).tiny))
            step = np.linalg.lstsq(block / np.outer(scale, scale), -gradient[chosen] / scale, 1e-14)
            values[chosen] += step[0] / scale
            if solution + 1 < solutions:
                residuals = self.residuals(self.unpack(values))
                # Where the predictor diverges, the first solution stands.
                if not np.abs(residuals).max() < DIVERGED:
                    break
                whitener = np.asarray(np.linalg.cholesky(floored_covariance(residuals)))
        return self.unpack(values)

    def _linear_entries(self, feedthrough: tuple[bool, ...] | None) -> NDArray[np.intp]:
        n, m, p = self.order, self.data.n_inputs, self.data.n_outputs
        start_b, start_d = n * n, n * (n + m + p)
        states = start_d + p * m + n * p + np.arange(n * len(self.data.lengths))
        if feedthrough is None:
            return states
        D = start_d + np.flatnonzero(np.tile(feedthrough, p))
        return np.concatenate([start_b + np.arange(n * m), D, states])

    def simulated(self, matrices: Matrices) -> FloatArray:
        """(n_samples, n_outputs) outputs from the inputs alone, initial states fitted, scaled."""
        with np.errstate(all="ignore"):
            free = replace(matrices, K=np.zeros_like(matrices.K))
            if is_stable(free.A):
                free = self.linear(free, None, gain=False, solutions=1)
            return self.data.outputs - self.core.residuals(free.pack())


def floored_covariance(residuals: FloatArray) -> FloatArray:
    """E'E / N, kept away from singular."""
    covariance = residuals.T @ residuals / len(residuals)
    return covariance + FLOOR * np.eye(len(covariance))


def fit_percent(measured: FloatArray, modelled: FloatArray) -> tuple[float, ...]:
    """100 (1 - |y - yhat| / |y - mean y|) of each column; -inf where the model diverges."""
    with np.errstate(all="ignore"):
        miss = np.linalg.norm(measured - modelled, axis=0)
        spread = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
        fit = 100.0 * (1.0 - miss / np.where(spread > 0.0, spread, np.nan))
    return tuple(float(value) if np.isfinite(value) else -np.inf for value in fit)


def assemble(
    data: Stack,
    matrices: Matrices,
    method: Literal["subspace", "pem", "output-error"],
    status: Literal["estimated", "converged", "iteration-limit", "stalled", "not-determined"],
    feedthrough: tuple[bool, ...],
    warnings: tuple[Diagnostic, ...] = (),
) -> StateSpace:
    """The record of a model of scaled channels, in the user's units."""
    evaluator = Evaluator(data, matrices.order)
    residuals = evaluator.residuals(matrices)
    n, m, p = matrices.order, data.n_inputs, data.n_outputs
    n_gain = 0 if method == "output-error" else n * p
    n_parameters = n * m + n * p + p * sum(feedthrough) + n_gain + n * len(data.lengths)
    samples = data.n_samples
    covariance = floored_covariance(residuals)
    log_scale = samples * float(np.log(data.output_scale).sum())
    cost = 0.5 * samples * float(np.linalg.slogdet(covariance)[1])
    # Every output's mean square is short by the parameters fitted to it.
    unbiased = covariance * samples / max(samples - n_parameters / p, 1.0)
    own = unscale(matrices, data)
    return StateSpace(
        A=own.A,
        B=own.B,
        C=own.C,
        D=own.D,
        K=own.K,
        noise_covariance=unbiased * np.outer(data.output_scale, data.output_scale),
        initial_states=own.initial_states,
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
