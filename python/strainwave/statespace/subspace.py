"""A state-space model straight from data: no start, no iterations, no local minima.

Three ways to the states. "moesp" takes A and C from the space in which the past moves future
outputs once future inputs are projected out (Verhaegen and Dewilde, Int. J. Control 56, 1992) and
the states from the oblique projection of N4SID (Van Overschee and De Moor, Automatica 30, 1994).
"n4sid" takes that projection's own singular vectors as states and regresses everything on them.
"predictor" builds the states from a long autoregression, whose innovations are white under feedback
too (Jansson's SSARX, 2003; Chiuso's PBSID_opt, Automatica 43, 2007): the one to use in closed loop.

All work on the triangular factor of the data alone. B, D and the initial state are estimated anew
as the least-squares solution of the whole predictor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, StateSpace
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.statespace._entries import Matrices, balanced
from strainwave.statespace._evaluate import FLOOR, Evaluator, assemble
from strainwave.statespace._hankel import solve_upper, triangular_factor
from strainwave.statespace._riccati import innovations_gain, stabilising_gain
from strainwave.statespace._stack import Data, Stack, stack

Method = Literal["auto", "moesp", "n4sid", "predictor"]

# Past samples tried at most. Lightly damped joints ring for longer, but what a longer past would
# add to the start is less than the prediction-error step finds anyway.
LONGEST_HORIZON = 40

# Orders among which the singular values choose.
HIGHEST_ORDER = 10


_DIVERGES = Diagnostic(
    "subspace-not-determined",
    "state-space model",
    "the predictor diverges on its own data. Take off means and drifts, or change the order",
)


@dataclass(frozen=True, slots=True)
class Realisation:
    """A model of scaled channels from one factorisation."""

    matrices: Matrices
    singular_values: FloatArray
    horizon: int


def subspace(
    data: Data,
    order: int | None = None,
    *,
    method: Method = "auto",
    horizon: int | None = None,
    feedthrough: tuple[bool, ...] | None = None,
) -> StateSpace:
    """Estimate a state-space model by a subspace method.

    `data`: Records are never joined: no row of the Hankel matrix spans two of them.
    `order`: None: the largest ratio between successive singular values decides.
    `method`: "auto" runs MOESP and the predictor and keeps the one that predicts better.
    `horizon`: Past samples of a row, and future ones. None: as many as Akaike's criterion gives an
        autoregression of the data.
    `feedthrough`: Whether the input acts on the outputs at once. None: inputs of hold "first" do,
        for their slope towards the next sample is not known yet.

    Returns: `status` is "estimated", or "not-determined" where the model does not predict the data
    at all; then a warning says so.

    Raises `InvalidInput`: shapes, entries that are not finite, an order or horizon below one, a
    horizon too short for the order; `NotIdentifiable`: too few samples for the order or the
    horizon.
    """
    _check(order, horizon, method)
    stacked = stack(data)
    return _estimate(Factors(stacked), order, method, horizon, feedthrough)


def subspace_orders(data: Data) -> Callable[[int], StateSpace]:
    """A function from an order to `subspace(data, order, method="predictor")`.

    The data are factorised only once. MOESP's models would rarely change which order is best, and
    take as long again.
    """
    factors = Factors(stack(data))
    return lambda order: _estimate(factors, order, "predictor", None, None)


def _estimate(
    factors: Factors,
    order: int | None,
    method: Method,
    horizon: int | None,
    feedthrough: tuple[bool, ...] | None,
) -> StateSpace:
    data = factors.data
    through = check_feedthrough(feedthrough, data)
    realisation = realise(factors, order, method, horizon, through)
    evaluator = Evaluator(data, realisation.matrices.order)
    matrices = evaluator.linear(realisation.matrices, through, gain=True)
    if np.isfinite(evaluator.cost(matrices.pack())):
        model = assemble(data, matrices, "subspace", "estimated", through)
    else:
        model = assemble(data, matrices, "subspace", "not-determined", through, (_DIVERGES,))
    return replace(model, singular_values=realisation.singular_values, horizon=realisation.horizon)


class Factors:
    """The triangular factors of one stack of data, and their singular vectors, by horizon."""

    def __init__(self, data: Stack) -> None:
        self.data = data
        self._known: dict[tuple[str, int], Any] = {}

    def regression(self, past: int) -> FloatArray:
        """R of [u[k], z[k-1], ..., z[k-past], y[k]]."""

        def factor() -> FloatArray:
            return triangular_factor(self.data, past + 1, _regression_order(self.data, past))[0]

        return cast("FloatArray", self._once("regression", past, factor))

    def predictor(self, past: int) -> Directions:
        """Of the predictor's products of C (A - K C)^j with the states."""
        return cast("Directions", self._once("predictor", past, lambda: _predictor(self, past)))

    def oblique(self, past: int) -> Directions:
        """Of future outputs on the past, future inputs projected out."""
        return cast("Directions", self._once("oblique", past, lambda: _oblique(self, past)))

    def past_and_future(self, past: int) -> FloatArray:
        """R of [future inputs, past w, future outputs]."""
        return cast(
            "FloatArray",
            self._once("past-and-future", past, lambda: _past_and_future(self.data, past)),
        )

    def _once(self, name: str, past: int, work: Callable[[], Any]) -> Any:
        if (name, past) not in self._known:
            self._known[name, past] = work()
        return self._known[name, past]


@dataclass(frozen=True, slots=True)
class Directions:
    """A matrix of which the states are the leading singular directions."""

    matrix: FloatArray
    singular_values: FloatArray
    vectors: FloatArray  # one column a direction


def realise(
    factors: Factors,
    order: int | None,
    method: Method,
    horizon: int | None,
    feedthrough: tuple[bool, ...],
) -> Realisation:
    """The better realisation, by the determinant of its innovations, in balanced coordinates."""
    data = factors.data
    ways = ("moesp", "predictor") if method == "auto" else (method,)
    length = horizon or choose_horizon(data, order or HIGHEST_ORDER)
    _check_length(data, order or 1, length)
    best: tuple[float, Realisation] | None = None
    for way in ways:
        realisation = _WAYS[way](factors, order, length, feedthrough)
        if len(ways) == 1:
            return realisation
        evaluator = Evaluator(data, realisation.matrices.order)
        matrices = evaluator.linear(realisation.matrices, feedthrough, gain=True)
        cost = evaluator.cost(matrices.pack())
        if best is None or cost < best[0]:
            best = cost, realisation
    assert best is not None
    return best[1]


def check_feedthrough(feedthrough: tuple[bool, ...] | None, data: Stack) -> tuple[bool, ...]:
    """One flag an input."""
    if feedthrough is None:
        return tuple(hold == "first" for hold in data.hold)
    if len(feedthrough) != data.n_inputs:
        raise InvalidInput(
            f"expected feedthrough for each of {data.n_inputs} inputs, got {len(feedthrough)}"
        )
    return tuple(bool(flag) for flag in feedthrough)


def choose_horizon(data: Stack, order: int) -> int:
    """Past samples after which more of them no longer predict better (Akaike's criterion).

    One factor answers for every length: with columns [u[k], z[k-1], z[k-2], ..., y[k]] the rows of
    R below a column hold the residual of y[k] once all columns before are known.
    """
    width = data.n_inputs + data.n_outputs
    longest = max(len_ for len_ in data.lengths)
    # Each past sample costs `width` regressors; five rows for each, and never more than the record.
    most = min(LONGEST_HORIZON, data.n_samples // (5 * width), (longest - 1) // 3)
    least = min(max(order + 1, 2), max(most, 1))
    if most <= least:
        return least
    R, rows = triangular_factor(data, most + 1, _regression_order(data, most))
    left = R[:, -data.n_outputs :]
    products = np.einsum("ki,kj->kij", left, left)[::-1].cumsum(axis=0)[::-1]
    starts = data.n_inputs + width * np.arange(1, most + 1)
    covariance = products[starts] / rows + FLOOR * np.eye(data.n_outputs)
    criterion = rows * np.linalg.slogdet(covariance)[1]
    criterion += 2.0 * width * data.n_outputs * np.arange(1, most + 1)
    return max(least, 1 + int(np.argmin(criterion)))


def _regression_order(data: Stack, past: int) -> FloatArray:
    """Columns as [u[k], z[k-1], ..., z[k-past], y[k]] from windows [z[k-past], ..., z[k]]."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    now = past * width
    lags = np.arange(past * width).reshape(past, width)[::-1].ravel()
    return np.concatenate([now + np.arange(m), lags, now + np.arange(m, width)])


def _predictor(factors: Factors, past: int) -> Directions:
    """Autoregression y[k] = D u[k] + sum M_i z[k-i] + e[k], whose M_i give the states' rows.

    M_i = C (A - K C)^(i-1) [B - K D, K]. The products of C (A - K C)^j with the states are sums of
    M_(i+j) z[k-i]; terms beyond the past are negligible once M_past is.
    """
    m, p = factors.data.n_inputs, factors.data.n_outputs
    width = m + p
    R = factors.regression(past)
    lead = m + past * width
    coefficients = solve_upper(R[:lead, :lead], R[:lead, lead:])[m:].T
    padded = np.hstack([coefficients, np.zeros((p, past * width))])
    rows = np.vstack([padded[:, j * width : (j + past) * width] for j in range(past)])
    U, s, _ = np.linalg.svd(rows @ R[:, m:lead].T, full_matrices=False)
    return Directions(rows, s, U)


def _by_predictor(
    factors: Factors, order: int | None, past: int, feedthrough: tuple[bool, ...]
) -> Realisation:
    found = factors.predictor(past)
    s = found.singular_values
    n = order or _largest_gap(s)
    to_state = (found.vectors[:, :n].T @ found.matrix) / np.sqrt(s[:n])[:, None]
    return _from_states(factors, to_state, past, s, feedthrough, given=None)


def _oblique(factors: Factors, past: int) -> Directions:
    R, known, lead = factors.past_and_future(past), *_places(factors.data, past)
    L_wy = R[known:lead, lead:]  # future outputs on the past, future inputs projected out
    _, s, Vt = np.linalg.svd(np.linalg.qr(L_wy, mode="r"))
    return Directions(L_wy, s, Vt.T)


def _moesp(
    factors: Factors, order: int | None, past: int, feedthrough: tuple[bool, ...]
) -> Realisation:
    """A and C from the extended observability matrix, states from the oblique projection."""
    p, (known, lead) = factors.data.n_outputs, _places(factors.data, past)
    R, found = factors.past_and_future(past), factors.oblique(past)
    s = found.singular_values
    n = order or _largest_gap(s)
    observability = found.vectors[:, :n] * np.sqrt(s[:n])
    C = observability[:p]
    A = np.asarray(np.linalg.lstsq(observability[:-p], observability[p:], rcond=None)[0])
    # x = O^+ (oblique projection) = O^+ L_wy' L_ww'^-1 w
    right = found.matrix @ np.linalg.pinv(observability).T
    oblique = solve_upper(R[known:lead, known:lead], right)
    return _from_oblique(factors, oblique, past, s, feedthrough, given=(A, C))


def _n4sid(
    factors: Factors, order: int | None, past: int, feedthrough: tuple[bool, ...]
) -> Realisation:
    """States from the oblique projection itself, unweighted; A, B, C, D by regression on them."""
    R, (known, lead) = factors.past_and_future(past), _places(factors.data, past)
    onto_past = solve_upper(R[known:lead, known:lead], R[known:lead, lead:])
    # the projection's rows are w' onto_past; all of w counts, not only what future inputs leave
    _, s, Vt = np.linalg.svd(np.linalg.qr(R[:lead, known:lead] @ onto_past, mode="r"))
    n = order or _largest_gap(s)
    observability = Vt[:n].T * np.sqrt(s[:n])
    oblique = onto_past @ np.linalg.pinv(observability).T
    return _from_oblique(factors, oblique, past, s, feedthrough, given=None)


def _past_and_future(data: Stack, past: int) -> FloatArray:
    """R of [future inputs, past w, future outputs]."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    window = np.arange(2 * past * width).reshape(2 * past, width)
    history, future = window[:past], window[past:]
    columns = [future[:, :m], history, future[:, m:]]
    return triangular_factor(data, 2 * past, np.concatenate([c.ravel() for c in columns]))[0]


def _places(data: Stack, past: int) -> tuple[int, int]:
    """Where the past begins and where it ends among the columns of `_past_and_future`."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    return past * m, past * m + past * width


def _from_oblique(
    factors: Factors,
    oblique: FloatArray,
    past: int,
    singular_values: FloatArray,
    feedthrough: tuple[bool, ...],
    given: tuple[FloatArray, FloatArray] | None,
) -> Realisation:
    """From the states as combinations of the past, (past * width, n), oldest sample first."""
    n = oblique.shape[1]
    to_state = oblique.T.reshape(n, past, -1)[:, ::-1].reshape(n, -1)
    return _from_states(factors, to_state, past, singular_values, feedthrough, given)


def _from_states(
    factors: Factors,
    to_state: FloatArray,
    past: int,
    singular_values: FloatArray,
    feedthrough: tuple[bool, ...],
    given: tuple[FloatArray, FloatArray] | None,
) -> Realisation:
    """Regress outputs and next states on states and inputs; the residuals give K.

    The factor R of [u[k], z[k-1], ..., z[k-past], y[k]] stands for the data: it has one sample
    more than the past, so that the state one sample on has its whole past as well.
    """
    data, R = factors.data, factors.regression(past)
    m, p = data.n_inputs, data.n_outputs
    width = m + p
    lead = m + past * width
    n = len(to_state)
    u, y = R[:, :m], R[:, lead:]
    x = R[:, m:lead] @ to_state.T
    # One sample on, the newest sample is [u[k], y[k]] and the oldest is forgotten.
    shifted = np.hstack([u, y, R[:, m : lead - width]])
    following = shifted @ to_state.T
    through = np.array(feedthrough)
    D = np.zeros((p, m))
    if given is None:
        state = _regression(np.hstack([x, u]), following)
        output = _regression(np.hstack([x, u[:, through]]), y)
        A, B, C = state[:, :n], state[:, n:], output[:, :n]
        D[:, through] = output[:, n:]
    else:
        A, C = given
        B = _regression(u, following - x @ A.T)
        D[:, through] = _regression(u[:, through], y - x @ C.T)
    residuals = np.hstack([following - x @ A.T - u @ B.T, y - x @ C.T - u @ D.T])
    noise = residuals.T @ residuals / max(data.n_samples, 1)
    noise[n:, n:] += FLOOR * np.eye(p)
    K, innovation = innovations_gain(A, C, noise[:n, :n], noise[:n, n:], noise[n:, n:])
    K = stabilising_gain(A, C, K, innovation)
    states = np.zeros((len(data.lengths), n))
    matrices = Matrices(A, B, C, D, K, initial_states=states)
    return Realisation(balanced(matrices), singular_values, past)


def _regression(regressors: FloatArray, targets: FloatArray) -> FloatArray:
    """M of least norm with targets = regressors M' but for least squares."""
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=1e-12)[0].T, dtype=np.float64)


def _largest_gap(singular_values: FloatArray) -> int:
    """The order after which the singular values fall by the largest factor."""
    s = singular_values[: HIGHEST_ORDER + 1]
    s = np.maximum(s, 1e-14 * s[0])
    return 1 + int(np.argmax(s[:-1] / s[1:])) if len(s) > 1 else 1


def _check_length(data: Stack, order: int, horizon: int) -> None:
    """Whether `horizon` samples show `order` states, and the records have as many and more."""
    p, width = data.n_outputs, data.n_inputs + data.n_outputs
    needed = 1 - (-order // p)
    # Rows of the longest Hankel matrix, 2 * horizon samples wide.
    rows = sum(max(length - 2 * horizon + 1, 0) for length in data.lengths)
    if horizon < needed or rows < horizon * width:
        if data.n_samples > 4 * (needed + 1) * width and horizon < needed:
            raise InvalidInput(f"expected a horizon of at least {needed}, got {horizon}")
        raise NotIdentifiable(
            f"{data.n_samples} samples in {len(data.lengths)} records are too few for a model of "
            f"order {order} with a horizon of {horizon} samples"
        )


def _check(order: int | None, horizon: int | None, method: str) -> None:
    for name, number in (("order", order), ("horizon", horizon)):
        if number is not None and number < 1:
            raise InvalidInput(f"expected {name} of at least 1, got {number}")
    known = ("auto", *_WAYS)
    if method not in known:
        raise InvalidInput(
            f"expected method {', '.join(known[:-1])} or {known[-1]}, got {method!r}"
        )


_WAYS = {"moesp": _moesp, "n4sid": _n4sid, "predictor": _by_predictor}
