"""Prediction-error method: minimise the one-step prediction error of a state-space model.

The cost is the log determinant of the innovations' covariance. The compiled core minimises it over
all entries of A, B, C, D, K and the initial states, in local coordinates that exclude changes of
the state coordinates. With K estimated, the estimate is consistent in closed loop if the loop has a
delay. With K = 0 (output error), it is consistent in open loop only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args, get_type_hints

import numpy as np

from strainwave import _core
from strainwave.domain import (
    STATE_SPACE_MODEL,
    Clause,
    Diagnostic,
    FloatArray,
    SearchEnd,
    StateSpace,
)
from strainwave.domain.study import Focus
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.numerics.parallel import raise_if_stopped
from strainwave.statespace._evaluate import MIN_VARIANCE_SHARE, Evaluator, assemble, restrict_steps
from strainwave.statespace._scaled import (
    Data,
    ModelMatrices,
    Stack,
    balance,
    n_entries,
    reflect_poles,
    rescale,
    stabilise,
    stack,
    unscale,
)
from strainwave.statespace.residuals import whiteness
from strainwave.statespace.subspace import (
    MAX_ORDER,
    Factors,
    check_feedthrough,
    choose_horizon,
    realise,
)

_LOWEST_FIT = -1000.0  # [%] shown; the simulation of an unstable model grows without bound
# K = 0 is not tried if its cost at the plant's poles exceeds the bound of the Bayesian information
# criterion by this factor.
_MAX_ZERO_GAIN_COST_FACTOR = 3.0


@dataclass(frozen=True, slots=True)
class PemOptions:
    """Options of `pem`."""

    # "stability": the best stable model, if that of "prediction" is unstable
    focus: Focus = "prediction"
    disturbance: Literal["innovations", "none"] = "innovations"  # "none": K = 0, output error
    # one flag per input; None: True for first-order hold
    feedthrough: tuple[bool, ...] | None = None
    initial_state: Literal["estimate", "zero"] = "estimate"
    covariance: Literal["auto", "white", "sandwich"] = "auto"  # "auto": by a whiteness test
    max_iterations: int = 100
    # Convergence tolerance on the predicted increase of the log-likelihood. At 1e-4, the parameters
    # are within sqrt(2e-4) = 0.014 standard deviations of the optimum.
    tolerance: float = 1e-4


def pem(
    data: Data,
    order: int | None = None,
    *,
    start: StateSpace | None = None,
    options: PemOptions | None = None,
) -> StateSpace:
    """Estimate a state-space model by the prediction-error method.

    - `data`: All records are fitted together; each has its own initial state.
    - `order`: None: the order of `start`. Use `select_order` to compare orders.
    - `start`: None: the better of two subspace estimates. A start with another sampling period is
      converted.

    `status` is "converged"; "iteration-limit" or "stalled", both with a warning; or
    "not-determined" if the data do not determine all parameters. A warning also reports an output
    whose simulation error exceeds its variation.

    With the focus "stability", a fit whose A is unstable is repeated among stable models: a barrier
    -(1/2) log det(I - A (x) A) is added to the negative log-likelihood, and a warning is given. The
    likelihood is then that of the best stable model, up to half a unit per pole at the limit.

    Raises `InvalidInput` for wrong shapes, entries that are not finite, an order below 1, neither
    order nor start, or a start that does not match the data. Raises `NumericalFailure` if no
    starting value has a stable predictor.
    """
    options = options or PemOptions()
    _check(order, start, options)
    stacked = stack(data)
    through = check_feedthrough(options.feedthrough, stacked)
    starts = _starts(stacked, order, start, through, options)
    evaluator = Evaluator(stacked, starts[0].order)
    search = _Search(evaluator, through, replace(options, focus="prediction"))
    best = search.best_fit(starts)
    if options.focus == "prediction" or _core.is_stable(best.matrices.A):
        return search.model(best)
    stable = [stabilise(each) for each in (*starts, best.matrices)]
    starts = [evaluator.linear(each, through, gain=True, solutions=1) for each in stable]
    modulus = float(np.abs(np.linalg.eigvals(best.matrices.A)).max())
    warning = Diagnostic("stability-enforced", STATE_SPACE_MODEL, modulus=modulus)
    search = _Search(evaluator, through, options)
    model = search.model(search.best_fit(starts))
    return replace(model, warnings=(*model.warnings, warning))


@dataclass(frozen=True, slots=True)
class _PredictionErrorFit:
    matrices: ModelMatrices
    covariance: FloatArray | None  # of the packed entries and initial states, scaled
    cost: float
    predicted_decrease: float
    iterations: int
    evaluations: int
    end: SearchEnd


@dataclass(frozen=True, slots=True)
class _Search:
    """Fits of one data set with the same options."""

    evaluator: Evaluator
    feedthrough: tuple[bool, ...]
    options: PemOptions

    def best_fit(self, starts: list[ModelMatrices]) -> _PredictionErrorFit:
        fits = []
        for start in sorted(starts, key=self.evaluator.cost):
            fit = self._fit(start)
            fits += [] if fit is None else [fit]
            if fit is not None and fit.end is SearchEnd.CONVERGED:
                break
        if not fits:
            raise NumericalFailure("no start of the prediction-error fit has a stable predictor")
        best = min(fits, key=lambda fit: fit.cost)
        if self.options.disturbance == "innovations" and best.end is SearchEnd.CONVERGED:
            best = self._without_gain(best) or self._restricted(best)
        return best

    def _without_gain(self, best: _PredictionErrorFit) -> _PredictionErrorFit | None:
        """Fit with K = 0 if the data do not require a gain, otherwise None.

        If the disturbances are white, K is zero and the predictor is as slow as the plant. In a
        short record, an estimate of K then only adds variance to all other entries.
        """
        evaluator = self.evaluator
        without_gain = replace(best.matrices, K=np.zeros_like(best.matrices.K))
        if best.covariance is None or not _core.is_stable(without_gain.A):
            return None
        # Bayesian information criterion, as for the order: the likelihood ratio is not chi-square
        limit = best.cost + 0.5 * without_gain.K.size * np.log(evaluator.data.n_samples)
        start = evaluator.linear(without_gain, self.feedthrough, gain=False, solutions=1)
        highest = best.cost + _MAX_ZERO_GAIN_COST_FACTOR * (limit - best.cost)
        if evaluator.cost(start) > highest:
            return None
        fit = replace(self, options=replace(self.options, disturbance="none"))._fit(start)
        if fit is None or fit.end is not SearchEnd.CONVERGED or fit.covariance is None:
            return None
        return fit if fit.cost < limit else None

    def _restricted(self, best: _PredictionErrorFit) -> _PredictionErrorFit:
        """Fit with the gain of the restricted likelihood, and its covariance."""
        matrices = restrict_steps(self.evaluator, best.matrices, best.covariance)
        if matrices is best.matrices:
            return best
        refit = replace(self, options=replace(self.options, max_iterations=0))._fit(matrices)
        if refit is None or refit.covariance is None:
            return best
        return replace(best, matrices=refit.matrices, covariance=refit.covariance, cost=refit.cost)

    def _fit(self, start: ModelMatrices) -> _PredictionErrorFit | None:
        """Fit from one starting value.

        None if the predictor or a model that must be stable is unstable, or innovations are not
        finite.
        """
        options, evaluator = self.options, self.evaluator
        if options.initial_state == "zero":
            start = replace(start, initial_states=np.zeros_like(start.initial_states))
        # Balanced coordinates improve the conditioning and reduce the number of iterations.
        start = balance(start)
        raise_if_stopped()
        try:
            fit = evaluator.core.fit(
                start.pack(),
                gain=options.disturbance == "innovations",
                feedthrough=list(self.feedthrough),
                initial_states=options.initial_state == "estimate",
                # without a gain, the predictor is the model
                stable=options.focus == "stability" and options.disturbance == "innovations",
                floor=[MIN_VARIANCE_SHARE] * evaluator.data.n_outputs,
                max_iterations=options.max_iterations,
                tolerance=options.tolerance,
            )
        except ValueError:  # unstable start or innovations that are not finite
            return None
        return _PredictionErrorFit(
            matrices=evaluator.unpack(fit.values),
            covariance=fit.covariance,
            cost=fit.cost,
            predicted_decrease=fit.predicted_decrease,
            iterations=fit.iterations,
            evaluations=fit.evaluations,
            end=SearchEnd(fit.status),
        )

    def model(self, fit: _PredictionErrorFit) -> StateSpace:
        data = self.evaluator.data
        method: Literal["pem", "output-error"]
        method = "pem" if self.options.disturbance == "innovations" else "output-error"
        status: SearchEnd | Literal["not-determined"]
        status = fit.end if fit.covariance is not None else "not-determined"
        warnings = _fit_warnings(fit, self.options)
        model = assemble(self.evaluator, fit.matrices, method, status, self.feedthrough, warnings)
        if fit.covariance is not None:
            kind = self.options.covariance
            if kind == "auto":
                fitted = fit.matrices.K.size if fit.matrices.K.any() else 0
                white = whiteness(self.evaluator.residuals(fit.matrices), data, fitted)
                kind = "white" if white.passed else "sandwich"
            full = fit.covariance
            if kind == "sandwich":
                full = _sandwich(self.evaluator, fit.matrices, full)
            freedom = data.n_samples - model.n_parameters / data.n_outputs
            full = full * data.n_samples / max(freedom, 1.0)
            size = n_entries(fit.matrices.order, data.n_inputs, data.n_outputs)
            scale = unscale(self.evaluator.unpack(np.ones(size)), data).pack()
            covariance = full[:size, :size] * np.outer(scale, scale)
            model = replace(model, covariance=covariance, covariance_kind=kind)
        warnings = (*model.warnings, *_negative_fit_warning(model))
        return replace(
            model, iterations=fit.iterations, evaluations=fit.evaluations, warnings=warnings
        )


def _starts(
    data: Stack,
    order: int | None,
    start: StateSpace | None,
    feedthrough: tuple[bool, ...],
    options: PemOptions,
) -> list[ModelMatrices]:
    if start is None:
        factors = Factors(data)
        horizon = choose_horizon(factors, order or MAX_ORDER)
        realisations = [
            realise(factors, order, method, horizon, feedthrough)[0]
            for method in ("predictor", "moesp")
        ]
    else:
        realisations = [_from_model(start, data)]
    linear = partial(
        Evaluator(data, realisations[0].order).linear, feedthrough=feedthrough, solutions=1
    )
    starts = [linear(replace(each, A=reflect_poles(each.A)), gain=False) for each in realisations]
    if options.disturbance == "innovations":
        # With sensor noise only, K = 0 and the predictor is as slow as the arm. A gain from the
        # subspace method is then far from the optimum, so both starting values are compared.
        starts += [linear(each, gain=True) for each in realisations]
    return starts


def _from_model(start: StateSpace, data: Stack) -> ModelMatrices:
    shape = (start.B.shape[1], start.C.shape[0])
    if shape != (data.n_inputs, data.n_outputs):
        raise InvalidInput(
            f"expected a start of {data.n_inputs} inputs and {data.n_outputs} outputs, "
            f"got {shape[0]} and {shape[1]}"
        )
    A, K, ratio = start.A, start.K, data.sample_time / start.sample_time
    if abs(ratio - 1.0) > 1e-9:  # B and D depend on the hold, so the fit re-estimates them
        values, vectors = np.linalg.eig(A)
        if ((values.imag == 0.0) & (values.real <= 0.0)).any():
            raise InvalidInput(
                f"expected a start at the data's {1.0 / data.sample_time:.6g} Hz, for its pole on "
                f"the negative real axis has no counterpart; got {1.0 / start.sample_time:.6g} Hz"
            )
        A = np.real((vectors * values.astype(complex) ** ratio) @ np.linalg.inv(vectors))
        K = ratio * K
    states = np.zeros((len(data.lengths), start.order))
    scaled = rescale(ModelMatrices(A, start.B, start.C, start.D, K, states), data)
    noise = start.noise_covariance / np.outer(data.output_scale, data.output_scale)
    noise = noise + MIN_VARIANCE_SHARE * np.eye(len(noise))
    return replace(scaled, K=_core.stabilising_gain(scaled.A, scaled.C, scaled.K, noise))


def _fit_warnings(fit: _PredictionErrorFit, options: PemOptions) -> tuple[Diagnostic, ...]:
    warnings, place, decrease = [], STATE_SPACE_MODEL, fit.predicted_decrease
    if fit.end is SearchEnd.EVALUATION_LIMIT:
        values = {"iterations": fit.iterations, "decrease": decrease}
        warnings.append(Diagnostic("pem-iteration-limit", place, **values))
    if fit.end is SearchEnd.STALLED:
        variant = "" if options.disturbance != "none" else "output-error"
        warnings.append(Diagnostic("pem-stalled", place, variant, decrease=decrease))
    if fit.covariance is None:
        warnings.append(Diagnostic("pem-not-determined", place))
    return tuple(warnings)


def _negative_fit_warning(model: StateSpace) -> tuple[Diagnostic, ...]:
    """Warning for outputs whose simulated fit is negative.

    One-step predictions can still be accurate, because the last measured sample determines most of
    the next one.
    """
    names = model.output_names or tuple(f"output {k + 1}" for k in range(len(model.C)))
    pairs = zip(names, model.fit_percent, strict=True)
    fits = tuple(
        Clause("fit", channel=name, fit=float(fit))
        if fit >= _LOWEST_FIT
        else Clause("fit/below", channel=name, fit=_LOWEST_FIT)
        for name, fit in pairs
        if fit < 0.0
    )
    if not fits:
        return ()
    return (Diagnostic("negative-fit", STATE_SPACE_MODEL, fits=fits),)


def _sandwich(evaluator: Evaluator, matrices: ModelMatrices, bread: FloatArray) -> FloatArray:
    """Sandwich covariance H^-1 [sum over lags of E s[t] s[t+lag]'] H^-1 with scores s = e' W psi.

    Bartlett weights estimate the middle matrix (Newey and West, Econometrica 55, 1987), computed as
    sums over a sliding window. The matrix is positive semidefinite, and the work does not depend on
    the window. The window is twice the correlation length of the innovations.
    """
    data = evaluator.data
    residuals = evaluator.residuals(matrices)
    scores = evaluator.core.scores(matrices.pack(), evaluator.whitener(matrices))
    window = _correlation_window(residuals, data)
    size, entries = len(bread), scores.shape[1] - evaluator.order
    middle = np.zeros((size, size))
    for index, rows in enumerate(data.rows()):
        state_entries = entries + index * evaluator.order + np.arange(evaluator.order)
        indices = np.concatenate([np.arange(entries), state_entries])
        padded = np.zeros((rows.stop - rows.start + 2 * window - 1, scores.shape[1]))
        padded[window : window + rows.stop - rows.start] = scores[rows]
        sums = np.cumsum(padded, axis=0)
        window_sums = sums[window:] - sums[:-window]
        middle[np.ix_(indices, indices)] += window_sums.T @ window_sums / window
    return bread @ middle @ bread


def _correlation_window(residuals: FloatArray, data: Stack) -> int:
    """Window of `_sandwich`: twice the last lag with a significant residual autocorrelation."""
    longest = max(2, min(max(data.lengths) // 10, 1000))
    last_lag = 1
    for rows in data.rows():
        record_residuals = residuals[rows]
        n = len(record_residuals)
        if n <= longest:
            continue
        spectrum = np.fft.rfft(record_residuals - record_residuals.mean(axis=0), 2 * n, axis=0)
        correlation = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:longest]
        is_significant = np.abs(correlation) > 4.0 / np.sqrt(n) * correlation[:1]
        last_lag = max(last_lag, int(np.flatnonzero(is_significant.any(axis=1)).max(initial=1)))
    return min(2 * last_lag, longest)


def _check(order: int | None, start: StateSpace | None, options: PemOptions) -> None:
    if order is None and start is None:
        raise InvalidInput(
            "expected an order or a start, got neither",
            remedy="select_order(data).model is the best of several orders",
        )
    if order is not None and order < 1:
        raise InvalidInput(f"expected an order of at least 1, got {order}")
    if order is not None and start is not None and start.order != order:
        raise InvalidInput(f"expected a start of order {order}, got {start.order}")
    for name in ("focus", "disturbance", "initial_state", "covariance"):
        got, expected = getattr(options, name), get_args(get_type_hints(PemOptions)[name])
        if got not in expected:
            raise InvalidInput(f"expected {name} {' or '.join(expected)}, got {got!r}")
