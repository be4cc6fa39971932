"""Residual tests of state-space models: whiteness and independence of the inputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray, HypothesisTest, ModelCheck, StateSpace
from strainwave.domain.results.distributions import CI99_STDS, chi_square_tail
from strainwave.errors import InvalidInput
from strainwave.statespace._evaluate import Evaluator, fit_percent
from strainwave.statespace._scaled import Data, ModelMatrices, Stack, rescale, stack

# Significance level of the tests.
SIGNIFICANCE_LEVEL = 0.01

# Number of lags, as in MATLAB's `resid`.
DEFAULT_LAGS = 25

Name = Literal["white", "independent-of-past-inputs", "no-feedback"]

_MESSAGES: Mapping[Name, tuple[str, str]] = {
    "white": (
        "nothing in the residuals predicts the next ones",
        "residuals predict one another: raise the order, or do not trust covariances that assume "
        "white innovations",
    ),
    "independent-of-past-inputs": (
        "the model explains what the inputs do",
        "past inputs still move the residuals: raise the order, check delays and holds",
    ),
    "no-feedback": (
        "inputs do not depend on past residuals: no sign of feedback",
        "inputs depend on past residuals: data from closed loop. Trust a model with K estimated, "
        "not one with K = 0",
    ),
}
"""Results of the tests in one sentence: passed, failed."""


def check_model(model: StateSpace, data: Data, *, lags: int = DEFAULT_LAGS) -> ModelCheck:
    """Test a model on data, preferably on data that were not used for the fit.

    The initial states are fitted to `data`. The tests treat the model as known, so they reject too
    rarely on the data of the fit.

    The result has the fits of simulation and one-step prediction, and three tests. An output-error
    model has no noise model, so its residuals may fail the whiteness test. Raises `InvalidInput`
    like `pem`.
    """
    stacked = stack(data)
    evaluator, matrices = on_data(model, stacked)
    residuals = evaluator.residuals(matrices)
    simulation_errors = evaluator.simulation_errors(matrices)
    fits, prediction_fits = fit_percent(stacked.outputs, simulation_errors, residuals)
    lags = max(1, min(lags, max(stacked.lengths) // 4))
    cross_tests, cross_correlation = _cross_tests(residuals, stacked, lags)
    scale = np.sqrt(np.sum(residuals**2, axis=0))
    normaliser = np.maximum(np.outer(scale, scale), np.finfo(float).tiny)
    return ModelCheck(
        fit_percent=fits,
        prediction_fit_percent=prediction_fits,
        tests=(whiteness(residuals, stacked, lags=lags), *cross_tests),
        autocorrelation=_correlations(residuals, residuals, stacked, lags) / normaliser,
        cross_correlation=cross_correlation,
        confidence_99=CI99_STDS / float(np.sqrt(stacked.n_samples)),
    )


def on_data(model: StateSpace, data: Stack) -> tuple[Evaluator, ModelMatrices]:
    """Evaluator and scaled model with initial states fitted to the data."""
    expected, got = (model.B.shape[1], len(model.C)), (data.n_inputs, data.n_outputs)
    if expected != got:
        raise InvalidInput(f"expected (inputs, outputs) {expected} as the model has, got {got}")
    if abs(model.sample_time / data.sample_time - 1.0) > 1e-6:
        raise InvalidInput(
            f"expected the model's sample time {model.sample_time}, got {data.sample_time}",
            remedy="resample the data, or fit a model to them",
        )
    states = np.zeros((len(data.lengths), model.order))
    matrices = ModelMatrices(model.A, model.B, model.C, model.D, model.K, states)
    evaluator = Evaluator(data, model.order)
    return evaluator, evaluator.linear(rescale(matrices, data), None, gain=True)


def whiteness(
    residuals: FloatArray, data: Stack, fitted: int = 0, lags: int = DEFAULT_LAGS
) -> HypothesisTest:
    """Multivariate portmanteau test (Hosking, JASA 75, 1980).

    The statistic N^2 sum over lags of tr(R_l' R_0^-1 R_l R_0^-1) / (N - l) is chi-square with p^2
    lags - `fitted` degrees of freedom. `fitted` is the number of parameters that whiten the
    residuals: the entries of K, because the inputs determine A.
    """
    lags = max(1, min(lags, max(data.lengths) // 4))
    samples, p = residuals.shape
    correlations = _correlations(residuals, residuals, data, lags) / samples
    R0_inverse = np.linalg.pinv(correlations[0])
    statistic = 0.0
    for lag in range(1, lags + 1):
        R = correlations[lag]
        statistic += samples**2 / (samples - lag) * np.trace(R.T @ R0_inverse @ R @ R0_inverse)
    degrees = max(p * p * lags - fitted, 1)
    return _test_result("white", statistic, degrees)


def _cross_tests(
    residuals: FloatArray, data: Stack, lags: int
) -> tuple[tuple[HypothesisTest, HypothesisTest], FloatArray]:
    """Tests of e[k] against u[k - l], l = 0..lags, and against u[k + l], l = 1..lags.

    Also returns the correlations (2 lags + 1, n_outputs, n_inputs), normalised.

    r_l = sum e[k] u[k - l] / N has the covariance sum_j R_e(j) (x) R_u(j + l - l') / N (Ljung,
    System Identification, 2nd ed., 16.6). The tests are valid for coloured inputs and residuals.
    """
    samples, p = residuals.shape
    m = data.n_inputs
    r_e = _two_sided(_correlations(residuals, residuals, data, 2 * lags)) / samples
    r_u = _two_sided(_correlations(data.inputs, data.inputs, data, 3 * lags)) / samples
    forward = _correlations(residuals, data.inputs, data, lags) / samples  # e[k] u[k - l]
    backward = _correlations(data.inputs, residuals, data, lags) / samples  # u[k] e[k - l]
    backward = np.swapaxes(backward, 1, 2)
    # blocks sum_j R_e(j) (x) R_u(j + l' - l)
    zero_e, zero_u, offsets = len(r_e) // 2, len(r_u) // 2, np.arange(-2 * lags, 2 * lags + 1)
    blocks = {}
    for shift in range(-lags, lags + 1):
        shifted = r_u[zero_u + np.clip(offsets + shift, -3 * lags, 3 * lags)]
        products = np.einsum("jab,jcd->acbd", r_e[zero_e + offsets], shifted)
        blocks[shift] = products.reshape(p * m, -1)
    covariance = np.block([[blocks[j - i] for j in range(lags + 1)] for i in range(lags + 1)])
    covariance = covariance / samples
    statistic, degrees = _quadratic_form(forward.reshape(-1), covariance)
    past = _test_result("independent-of-past-inputs", statistic, degrees)
    block = p * m
    # Time reversal puts the lags in descending order; the covariance is block Toeplitz.
    statistic, degrees = _quadratic_form(backward[:0:-1].reshape(-1), covariance[:-block, :-block])
    future = _test_result("no-feedback", statistic, degrees)
    cross = np.concatenate([backward[:0:-1], forward])
    scale = np.sqrt(np.mean(residuals**2, axis=0)[:, None] * np.mean(data.inputs**2, axis=0))
    return (past, future), cross / np.maximum(scale, np.finfo(float).tiny)


def _quadratic_form(vector: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """Statistic v' P^+ v over the directions that the inputs excite, and its degrees of freedom."""
    covariance = 0.5 * (covariance + covariance.T)
    values, vectors = np.linalg.eigh(covariance)
    is_excited = values > 1e-6 * values[-1]
    amplitudes = vectors[:, is_excited].T @ vector
    return float(np.sum(amplitudes**2 / values[is_excited])), max(int(is_excited.sum()), 1)


def _correlations(left: FloatArray, right: FloatArray, data: Stack, lags: int) -> FloatArray:
    """Sum over all records of left[k] right[k - l]', of shape (lags + 1, n_left, n_right)."""
    total = np.zeros((lags + 1, left.shape[1], right.shape[1]))
    for rows in data.rows():
        a, b = left[rows], right[rows]
        for lag in range(min(lags + 1, len(a))):
            total[lag] += a[lag:].T @ b[: len(b) - lag]
    return total


def _two_sided(correlations: FloatArray) -> FloatArray:
    """Correlations at lags -L..L from those at lags 0..L, with R(-l) = R(l)'."""
    return np.concatenate([np.swapaxes(correlations[:0:-1], 1, 2), correlations])


def _test_result(name: Name, statistic: float, degrees: int) -> HypothesisTest:
    p_value = chi_square_tail(statistic, degrees)
    passed, (good, bad) = p_value >= SIGNIFICANCE_LEVEL, _MESSAGES[name]
    return HypothesisTest(name, float(statistic), degrees, p_value, passed, good if passed else bad)
