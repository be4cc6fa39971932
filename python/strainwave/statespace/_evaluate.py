"""Evaluation of models on stacked data: innovations, cost, linear least squares, Kalman gain.

Maximum likelihood attributes part of the noise to the plant. The residuals are then less coloured
than the noise, so K is biased towards zero (by half a standard deviation for one joint at 512
samples), and the standard deviations of all parameters are too small. Restricted likelihood
(Patterson and Thompson, Biometrika 58, 1971; Cox and Reid, J. R. Stat. Soc. B 49, 1987) adds

    (1/2) log det I_m(K)

to the cost. I_m is the information on A, B, C and D after elimination of the initial states. The
barrier at the unit circle accounts for the initial states. The minimum is about one Newton step
away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from strainwave import _core
from strainwave.domain import Diagnostic, FloatArray, SearchEnd, StateSpace
from strainwave.statespace._scaled import (
    ModelMatrices,
    Stack,
    balancing,
    unpack,
    unscale,
)

# Relative variance that regularises the innovations' covariance. It corresponds to innovations of
# 1e-10 of the channel's root mean square, far below the resolution of any sensor, and keeps the
# determinant finite for noise-free data.
MIN_VARIANCE_SHARE = 1e-20


class Evaluator:
    """Compiled one-step predictor for one data set and one model order."""

    def __init__(self, data: Stack, order: int) -> None:
        self.data = data
        self.order = order
        self.core = _core.Innovations(order, data.n_inputs, data.samples, data.lengths)
        self._last: tuple[ModelMatrices, FloatArray] | None = None

    def unpack(self, values: FloatArray) -> ModelMatrices:
        """Matrices from a vector in the layout of the core."""
        return unpack(values, self.order, self.data.n_inputs, self.data.n_outputs)

    def residuals(self, matrices: ModelMatrices) -> FloatArray:
        """Scaled innovations (n_samples, n_outputs); those of the last model are kept."""
        if self._last is None or self._last[0] is not matrices:
            self._last = matrices, self.core.residuals(matrices.pack())
        return self._last[1]

    def cost(self, matrices: ModelMatrices) -> float:
        """Cost (N/2) log det of the innovations' covariance; infinite for divergent innovations."""
        residuals = self.residuals(matrices)
        if not max(residuals.max(), -residuals.min()) < _core.DIVERGENCE_RATIO:
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
        solutions: Literal[1, 2] = 2,
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
        floor = MIN_VARIANCE_SHARE if solutions == 2 else None
        values = self.core.linear(matrices.pack(), feedthrough, floor)
        if values is None:
            raise np.linalg.LinAlgError("the predictor overflows over the record")
        return self.unpack(values)

    def simulation_errors(self, matrices: ModelMatrices) -> FloatArray:
        """Scaled outputs minus those simulated from the inputs, with fitted initial states."""
        simulator = replace(matrices, K=np.zeros_like(matrices.K))
        if _core.is_stable(simulator.A):
            simulator = self.linear(simulator, None, gain=False, solutions=1)
        return self.core.residuals(simulator.pack())


def limit_covariance(residuals: FloatArray) -> FloatArray:
    """Covariance E'E / N, regularised by `MIN_VARIANCE_SHARE`."""
    channels = residuals.T
    # one product of two channels at a time, which is faster than a product of narrow matrices
    covariance = np.vecdot(channels[:, None], channels) / len(residuals)
    return np.asarray(covariance + MIN_VARIANCE_SHARE * np.eye(len(covariance)))


def fit_percent(measured: FloatArray, *errors: FloatArray) -> list[tuple[float, ...]]:
    """Fits 100 (1 - |e| / |y - mean y|) of each column [%] for each array of errors.

    A fit is -inf if the model diverges.
    """
    with np.errstate(all="ignore"):
        # by products and contiguous samples, many times faster than sums along the first axis
        mean = np.ones(len(measured)) @ measured / len(measured)
        centred = np.subtract(measured.T, mean[:, None], order="C")
        scale = np.sqrt(np.vecdot(centred, centred))
        scale = np.where(scale > 0.0, scale, np.nan)
        fits = [100.0 * (1.0 - np.sqrt(np.vecdot(e.T, e.T)) / scale) for e in errors]
    return [tuple(float(x) if np.isfinite(x) else -np.inf for x in fit) for fit in fits]


def assemble(
    evaluator: Evaluator,
    matrices: ModelMatrices,
    method: Literal["subspace", "pem", "output-error"],
    status: SearchEnd | Literal["estimated", "not-determined"],
    feedthrough: tuple[bool, ...],
    warnings: tuple[Diagnostic, ...] = (),
) -> StateSpace:
    """Result record of a model of scaled channels, in the units of the data."""
    data, residuals = evaluator.data, evaluator.residuals(matrices)
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
    simulation_errors = evaluator.simulation_errors(matrices)
    fits, prediction_fits = fit_percent(data.outputs, simulation_errors, residuals)
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
        fit_percent=fits,
        prediction_fit_percent=prediction_fits,
        n_samples=samples,
        n_parameters=n_parameters,
        log_likelihood=-cost - log_scale - 0.5 * samples * p * (1.0 + float(np.log(2.0 * np.pi))),
        input_names=data.input_names,
        output_names=data.output_names,
        warnings=warnings,
    )


# Step of the central differences along an entry of K, in standard deviations: far above rounding,
# and small against the curvature of log det I_m.
_GAIN_STEP_STDS = 0.2

# Samples used for the gradient. More samples add a constant to log det I_m and hardly change its
# gradient.
_MAX_GRADIENT_SAMPLES = 1024

# Maximum number of step halvings, down to 1/16 of the initial step.
_MAX_STEP_HALVINGS = 5


def restrict_steps(
    evaluator: Evaluator, matrices: ModelMatrices, covariance: FloatArray | None
) -> ModelMatrices:
    """Model that minimises the sum of cost and (1/2) log det I_m, by one Newton step.

    `matrices`: Scaled model at the minimum of the cost.
    `covariance` (n_entries, n_entries): Covariance of its packed entries.

    Returns `matrices` unchanged without a covariance, or if no step decreases the sum.
    """
    if covariance is None:
        return matrices
    T = balancing(matrices)
    # the entries in other coordinates are linear in the entries, so unit vectors give the Jacobian
    change = evaluator.unpack(np.eye(len(covariance))).transformed(T).pack().T
    start, transformed_covariance = matrices.transformed(T), change @ covariance @ change.T
    values, slope = start.pack(), _gradient(evaluator, start, transformed_covariance)
    step = -transformed_covariance @ slope
    before = _cost(evaluator, values)
    for _ in range(_MAX_STEP_HALVINGS):
        # slope @ step is the first-order change of log det; the cost is evaluated
        if _cost(evaluator, values + step) + slope @ step < before:
            return evaluator.unpack(values + step).transformed(np.asarray(np.linalg.inv(T)))
        step = 0.5 * step
    return matrices


def _cost(evaluator: Evaluator, values: FloatArray) -> float:
    """Cost plus the barrier -(1/2) log det(I - F (x) F) at the stability limit, F = A - K C."""
    matrices = evaluator.unpack(values)
    F = matrices.A - matrices.K @ matrices.C
    if not _core.is_stable(F):
        return float("inf")
    barrier = -0.5 * float(np.linalg.slogdet(np.eye(F.size) - np.kron(F, F))[1])
    return evaluator.cost(matrices) + barrier


def _gradient(evaluator: Evaluator, matrices: ModelMatrices, covariance: FloatArray) -> FloatArray:
    """Gradient of (1/2) log det I_m over all entries, by central differences along K.

    The gradient is zero along the basis of I_m and along changes of state coordinates. These
    conditions determine the remaining entries.
    """
    coordinate_directions, n = _coordinate_directions(matrices), matrices.order
    n_plant = matrices.A.size + matrices.B.size + matrices.C.size + matrices.D.size
    states = n_plant + matrices.K.size
    std = np.sqrt(np.maximum(np.diagonal(covariance)[:n_plant], 0.0))
    nonzero = np.flatnonzero(std > 0.0)
    scaled_directions = coordinate_directions[nonzero] / std[nonzero, None]
    Q = np.linalg.qr(scaled_directions, mode="complete")[0][:, n * n :]
    basis = np.zeros((n_plant, Q.shape[1]))
    basis[nonzero] = std[nonzero, None] * Q
    half_log = _half_log_information(evaluator, matrices, basis, states)
    slope = np.zeros(len(covariance))
    for entry in range(n_plant, states):
        step = _GAIN_STEP_STDS * float(np.sqrt(max(covariance[entry, entry], 0.0)))
        for _ in range(_MAX_STEP_HALVINGS if step > 0.0 else 0):
            plus, minus = half_log(entry, step), half_log(entry, -step)
            if np.isfinite(plus - minus):
                slope[entry] = 0.5 * (plus - minus) / step
                break
            step *= 0.5  # near the stability limit, the predictor diverges on one side
    # A change of state coordinates also moves K; the gradient along A, B and C compensates for it.
    rows = np.vstack([Q.T, scaled_directions.T])
    of_gain = coordinate_directions[n_plant:].T @ slope[n_plant:states]
    targets = np.concatenate([np.zeros(Q.shape[1]), -of_gain])
    slope[nonzero] = np.linalg.lstsq(rows, targets, rcond=1e-10)[0] / std[nonzero]
    return slope


def _coordinate_directions(matrices: ModelMatrices) -> FloatArray:
    """Derivative of the entries of A, B, C, D, K with respect to T at T = I: (n_entries, n^2)."""
    A, B, C, n = matrices.A, matrices.B, matrices.C, matrices.order
    directions = []
    for k in range(n * n):
        X = np.zeros((n, n))
        X.flat[k] = 1.0
        parts = (X @ A - A @ X, X @ B, -C @ X, np.zeros_like(matrices.D), X @ matrices.K)
        directions.append(np.concatenate([np.ravel(part) for part in parts]))
    return np.stack(directions, axis=1)


def _half_log_information(
    evaluator: Evaluator, matrices: ModelMatrices, basis: FloatArray, states: int
) -> Callable[[int, float], float]:
    """(1/2) log det I_m near a model after a change of one entry; infinite if predictors diverge.

    The information is that of the first `_MAX_GRADIENT_SAMPLES` samples in the directions `basis`
    (n_plant, n_directions); `states` is the index of the first initial state.
    """
    data, lengths, remaining = evaluator.data, [], _MAX_GRADIENT_SAMPLES
    for length in data.lengths:
        if remaining > 0:
            lengths.append(min(length, remaining))
            remaining -= length
    # only the last record is truncated, so the rows are contiguous
    used = replace(data, samples=data.samples[: sum(lengths)], lengths=tuple(lengths))
    core, whitener = Evaluator(used, matrices.order).core, evaluator.whitener(matrices)
    values = matrices.pack()[: states + matrices.order * len(lengths)]

    def half_log(entry: int, step: float) -> float:
        changed = values.copy()
        changed[entry] += step
        hessian, _ = core.normal_equations(changed, whitener)
        if not np.isfinite(hessian).all():
            return float("inf")
        projected = basis.T @ hessian[: len(basis)]
        cross, state_block = projected[:, states:], hessian[states:, states:]
        information = projected[:, : len(basis)] @ basis
        information = information - cross @ np.linalg.pinv(state_block, hermitian=True) @ cross.T
        return 0.5 * float(np.linalg.slogdet(information)[1])

    return half_log
