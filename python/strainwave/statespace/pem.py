"""Prediction-error minimisation: the model whose one-step predictions miss by least.

The determinant of the innovations' covariance is minimised over all entries of A, B, C, D, K and
the initial states, in local coordinates that leave out changes of the state's basis; the work is
done by the compiled core. With K estimated the answer is consistent in closed loop too, provided
the loop has a delay; with K = 0 (output error) only in open loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, StateSpace
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.numerics.parallel import stop_if_asked
from strainwave.statespace._entries import Matrices, balanced, n_entries, rescale
from strainwave.statespace._evaluate import FLOOR, Evaluator, assemble
from strainwave.statespace._restricted import restricted
from strainwave.statespace._riccati import is_stable, reflected, stabilising_gain
from strainwave.statespace._stack import Data, Stack, stack
from strainwave.statespace.residuals import whiteness
from strainwave.statespace.subspace import (
    HIGHEST_ORDER,
    Factors,
    check_feedthrough,
    choose_horizon,
    realise,
)

# times what Schwarz's criterion allows: with that more cost at the plant's poles K is not zero
_SURELY = 3.0


@dataclass(frozen=True, slots=True)
class PemOptions:
    """How `pem` estimates."""

    disturbance: Literal["innovations", "none"] = "innovations"  # "none": K = 0, output error
    feedthrough: tuple[bool, ...] | None = None  # one an input; None: those of hold "first"
    initial_state: Literal["estimate", "zero"] = "estimate"
    covariance: Literal["auto", "white", "sandwich"] = "auto"  # auto: by a test of whiteness
    max_iterations: int = 100
    # Largest gain in log-likelihood still worth a step: parameters are then within
    # sqrt(2e-4) = 0.014 standard deviations of the optimum.
    tolerance: float = 1e-4


def pem(
    data: Data,
    order: int | None = None,
    *,
    start: StateSpace | None = None,
    options: PemOptions | None = None,
) -> StateSpace:
    """Estimate a state-space model by prediction-error minimisation.

    `data`: Several records, or windows of one, are fitted at once, each from its own initial state.
    `order`: None: that of `start`. Where it is not known, `select_order` compares several.
    `start`: None: the better of two subspace estimates. One of another rate is brought to the
        data's.

    Returns: `status` says how the search ended: "converged"; "iteration-limit" and "stalled" carry
    a warning with advice; "not-determined" means that the data leave a direction open. A model
    whose simulation misses an output by more than that output moves carries a warning, however well
    it predicts one step ahead.

    Raises `InvalidInput`: shapes, entries that are not finite, an order below one, neither order
    nor start, a start that does not fit the data; `NumericalFailure`: no start has a stable
    predictor.
    """
    options = options or PemOptions()
    _check(order, start, options)
    stacked = stack(data)
    through = check_feedthrough(options.feedthrough, stacked)
    candidates = _starts(stacked, order, start, through, options)
    evaluator = Evaluator(stacked, candidates[0].order)
    fits = []
    for candidate in sorted(candidates, key=lambda each: evaluator.cost(each.pack())):
        found = _fit(evaluator, candidate, through, options)
        fits += [] if found is None else [found]
        if found is not None and found.status == "converged":
            break
    if not fits:
        raise NumericalFailure("no start of the prediction-error fit has a stable predictor")
    best = min(fits, key=lambda fit: fit.cost)
    if options.disturbance == "innovations" and best.status == "converged":
        without = _without_gain(evaluator, best, through, options)
        best = without or _restricted(evaluator, best, through, options)
    return _model(evaluator, best, through, options)


def _without_gain(
    evaluator: Evaluator, best: _Fit, feedthrough: tuple[bool, ...], options: PemOptions
) -> _Fit | None:
    """The fit with K = 0 where the data ask for no more.

    Where the disturbances are white K is zero and the predictor as slow as the plant. An estimate
    of K is then all noise, far from normal on so short a record as the plant's own memory, and its
    scatter is in every other entry.
    """
    plain = replace(best.matrices, K=np.zeros_like(best.matrices.K))
    if best.covariance is None or not is_stable(plain.A):
        return None
    # Schwarz's criterion, as for the order: the ratio of likelihoods has no chi-square tail here
    most = best.cost + 0.5 * plain.K.size * np.log(evaluator.data.n_samples)
    start = evaluator.linear(plain, feedthrough, gain=False, solutions=1)
    if evaluator.cost(start.pack()) > best.cost + _SURELY * (most - best.cost):
        return None
    found = _fit(evaluator, start, feedthrough, replace(options, disturbance="none"))
    if found is None or found.status != "converged" or found.covariance is None:
        return None
    return found if found.cost < most else None


def _restricted(
    evaluator: Evaluator, best: _Fit, feedthrough: tuple[bool, ...], options: PemOptions
) -> _Fit:
    """The fit with the gain of restricted likelihood, and the covariance there."""
    moved = restricted(evaluator, best.matrices, best.covariance)
    if moved is best.matrices:
        return best
    there = _fit(evaluator, moved, feedthrough, replace(options, max_iterations=0))
    if there is None or there.covariance is None:
        return best
    return replace(best, matrices=there.matrices, covariance=there.covariance, cost=there.cost)


@dataclass(frozen=True, slots=True)
class _Fit:
    matrices: Matrices
    covariance: FloatArray | None  # of the packed entries and initial states, scaled
    cost: float
    promised: float
    iterations: int
    evaluations: int
    status: Literal["converged", "iteration-limit", "stalled"]


def _starts(
    data: Stack,
    order: int | None,
    start: StateSpace | None,
    feedthrough: tuple[bool, ...],
    options: PemOptions,
) -> list[Matrices]:
    """Starts whose predictors are stable."""
    if start is None:
        ways: tuple[Literal["predictor", "moesp"], ...] = ("predictor", "moesp")
        horizon, factors = choose_horizon(data, order or HIGHEST_ORDER), Factors(data)
        found = [realise(factors, order, way, horizon, feedthrough).matrices for way in ways]
    else:
        found = [_from_model(start, data)]
    evaluator = Evaluator(data, found[0].order)
    stable = [replace(each, A=reflected(each.A), K=np.zeros_like(each.K)) for each in found]
    starts = [evaluator.linear(each, feedthrough, gain=False, solutions=1) for each in stable]
    if options.disturbance == "innovations":
        # Sensor noise alone means K = 0, and the predictor is then as slow as the arm: a gain from
        # a subspace step lies far from it on a curved path. Both starts are weighed.
        starts += [evaluator.linear(each, feedthrough, gain=True, solutions=1) for each in found]
    return starts


def _from_model(start: StateSpace, data: Stack) -> Matrices:
    shape = (start.B.shape[1], start.C.shape[0])
    if shape != (data.n_inputs, data.n_outputs):
        raise InvalidInput(
            f"expected a start of {data.n_inputs} inputs and {data.n_outputs} outputs, "
            f"got {shape[0]} and {shape[1]}"
        )
    states = np.zeros((len(data.lengths), start.order))
    own = _at_rate(start, data.sample_time, states)
    scaled = rescale(own, data)
    noise = start.noise_covariance / np.outer(data.output_scale, data.output_scale)
    noise = noise + FLOOR * np.eye(len(noise))
    K = stabilising_gain(scaled.A, scaled.C, scaled.K, noise)
    return replace(scaled, K=K)


def _at_rate(start: StateSpace, sample_time: float, states: FloatArray) -> Matrices:
    """A start's matrices at another rate; B and D, which hang on the holds, are estimated anew."""
    A, K, ratio = start.A, start.K, sample_time / start.sample_time
    if abs(ratio - 1.0) > 1e-9:
        values, vectors = np.linalg.eig(A)
        if ((values.imag == 0.0) & (values.real <= 0.0)).any():
            raise InvalidInput(
                f"expected a start at the data's {1.0 / sample_time:.6g} Hz, for its pole on the "
                f"negative real axis has no counterpart; got {1.0 / start.sample_time:.6g} Hz"
            )
        powers = values.astype(complex) ** ratio
        A = np.real((vectors * powers) @ np.linalg.inv(vectors))
        K = ratio * K
    return Matrices(A, start.B, start.C, start.D, K, states)


def _fit(
    evaluator: Evaluator, start: Matrices, feedthrough: tuple[bool, ...], options: PemOptions
) -> _Fit | None:
    """None from a start whose predictor, or innovations, are not sound."""
    if options.initial_state == "zero":
        start = replace(start, initial_states=np.zeros_like(start.initial_states))
    # Coordinates are the fit's own affair: the better conditioned, the fewer its steps.
    start = balanced(start)
    stop_if_asked()
    try:
        fit = evaluator.core.fit(
            start.pack(),
            gain=options.disturbance == "innovations",
            feedthrough=list(feedthrough),
            initial_states=options.initial_state == "estimate",
            floor=[FLOOR] * evaluator.data.n_outputs,
            max_iterations=options.max_iterations,
            tolerance=options.tolerance,
        )
    except ValueError:  # an unstable predictor, or innovations that are not finite
        return None
    return _Fit(
        matrices=evaluator.unpack(fit.values),
        covariance=fit.covariance,
        cost=fit.cost,
        promised=fit.promised,
        iterations=fit.iterations,
        evaluations=fit.evaluations,
        status=fit.status,
    )


def _model(
    evaluator: Evaluator, fit: _Fit, feedthrough: tuple[bool, ...], options: PemOptions
) -> StateSpace:
    data = evaluator.data
    method: Literal["pem", "output-error"]
    method = "pem" if options.disturbance == "innovations" else "output-error"
    status = fit.status if fit.covariance is not None else "not-determined"
    warnings = _advice(fit, options)
    model = assemble(data, fit.matrices, method, status, feedthrough, warnings)
    model = replace(model, warnings=model.warnings + _unlike_simulation(model))
    covariance, kind = None, None
    if fit.covariance is not None:
        covariance, kind = _covariance(evaluator, fit, options, model.n_parameters)
    return replace(
        model,
        covariance=covariance,
        covariance_kind=kind,
        iterations=fit.iterations,
        evaluations=fit.evaluations,
    )


def _advice(fit: _Fit, options: PemOptions) -> tuple[Diagnostic, ...]:
    found = []
    if fit.status == "iteration-limit":
        found.append(
            Diagnostic(
                "pem-iteration-limit",
                "state-space model",
                f"not converged after {fit.iterations} steps; {fit.promised:.2g} of log-likelihood "
                "seems left. Raise max_iterations, or lower the order",
            )
        )
    if fit.status == "stalled":
        found.append(
            Diagnostic(
                "pem-stalled",
                "state-space model",
                f"the search stopped {fit.promised:.2g} of log-likelihood short of an optimum, "
                "mostly because that lies where the predictor is unstable. Take off means and "
                "drifts, lower the order, or "
                + ("fit an output-error model" if options.disturbance != "none" else "estimate K"),
            )
        )
    if fit.covariance is None:
        found.append(
            Diagnostic(
                "pem-not-determined",
                "state-space model",
                "the data leave a direction of the model open, so no covariance is given. Lower "
                "the order, or excite every input",
            )
        )
    return tuple(found)


def _unlike_simulation(model: StateSpace) -> tuple[Diagnostic, ...]:
    """A warning where the inputs alone explain less of an output than its mean would.

    One-step predictions may still be good: the last sample says most of the next one.
    """
    names = model.output_names or tuple(f"output {k + 1}" for k in range(len(model.C)))
    pairs = zip(names, model.fit_percent, strict=True)
    missed = [(name, fit) for name, fit in pairs if fit < 0.0]
    if not missed:
        return ()
    fits = ", ".join(f"{name} {fit:.0f} %" for name, fit in missed)
    text = f"simulated from the inputs alone it is worse than a constant ({fits}), though it "
    text += "predicts one step ahead: its response to the inputs is not to be trusted. Take off "
    text += "drifts, change the order, or estimate an output-error model"
    return (Diagnostic("negative-fit", "state-space model", text),)


def _covariance(
    evaluator: Evaluator, fit: _Fit, options: PemOptions, n_parameters: int
) -> tuple[FloatArray, Literal["white", "sandwich"]]:
    """Covariance of A, B, C, D, K in the user's units, and how it was found."""
    data = evaluator.data
    n, m, p = evaluator.order, data.n_inputs, data.n_outputs
    assert fit.covariance is not None
    kind = options.covariance
    residuals = evaluator.residuals(fit.matrices)
    if kind == "auto":
        fitted = n * p if fit.matrices.K.any() else 0
        white = whiteness(residuals, data, fitted)
        kind = "white" if white.passed else "sandwich"
    full = fit.covariance
    if kind == "sandwich":
        full = _sandwich(evaluator, fit.matrices, full)
    full = full * data.n_samples / max(data.n_samples - n_parameters / p, 1.0)
    size = n_entries(n, m, p)
    ones = np.ones((1, n))
    u, y = data.input_scale[None, :], data.output_scale[:, None]
    scale = np.concatenate(
        [np.ravel(part) for part in (np.ones((n, n)), ones.T / u, y * ones, y / u, ones.T / y.T)]
    )
    return full[:size, :size] * np.outer(scale, scale), kind


def _sandwich(evaluator: Evaluator, matrices: Matrices, bread: FloatArray) -> FloatArray:
    """H^-1 [sum over lags of E s[t] s[t+lag]'] H^-1 with the scores s = e' W psi.

    The middle is estimated with Bartlett's weights (Newey and West, Econometrica 55, 1987), which
    are sums over a sliding window: it stays positive semidefinite and costs the same at any length.
    The window is twice as long as the innovations remember.
    """
    data = evaluator.data
    residuals = evaluator.residuals(matrices)
    whitener = evaluator.whitener(matrices)
    scores = evaluator.core.scores(matrices.pack(), whitener)
    window = _memory(residuals, data)
    size, entries = len(bread), scores.shape[1] - evaluator.order
    middle = np.zeros((size, size))
    for index, rows in enumerate(data.rows()):
        own = entries + index * evaluator.order + np.arange(evaluator.order)
        place = np.concatenate([np.arange(entries), own])
        padded = np.zeros((rows.stop - rows.start + 2 * window - 1, scores.shape[1]))
        padded[window : window + rows.stop - rows.start] = scores[rows]
        sums = np.cumsum(padded, axis=0)
        slid = sums[window:] - sums[:-window]
        middle[np.ix_(place, place)] += slid.T @ slid / window
    return bread @ middle @ bread


def _memory(residuals: FloatArray, data: Stack) -> int:
    """Window of the sandwich: twice the last lag at which a residual is clearly correlated."""
    longest = max(2, min(max(data.lengths) // 10, 1000))
    last = 1
    for rows in data.rows():
        part = residuals[rows]
        n = len(part)
        if n <= longest:
            continue
        spectrum = np.fft.rfft(part - part.mean(axis=0), 2 * n, axis=0)
        correlation = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:longest]
        clear = np.abs(correlation) > 4.0 / np.sqrt(n) * correlation[:1]
        last = max(last, int(np.flatnonzero(clear.any(axis=1)).max(initial=1)))
    return min(2 * last, longest)


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
    closed = [
        ("disturbance", options.disturbance, ("innovations", "none")),
        ("initial_state", options.initial_state, ("estimate", "zero")),
        ("covariance", options.covariance, ("auto", "white", "sandwich")),
    ]
    for name, got, expected in closed:
        if got not in expected:
            raise InvalidInput(f"expected {name} {' or '.join(expected)}, got {got!r}")
