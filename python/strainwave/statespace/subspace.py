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

from dataclasses import dataclass, replace
from typing import Literal

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

    Parameters
    ----------
    data : InputOutput or sequence of InputOutput
        Records are never joined: no row of the Hankel matrix spans two of them.
    order : int, optional
        None: the largest ratio between successive singular values decides.
    method : "auto", "moesp", "n4sid" or "predictor"
        "auto" runs MOESP and the predictor and keeps the one that predicts better.
    horizon : int, optional
        Past samples of a row, and future ones. None: as many as Akaike's criterion gives an
        autoregression of the data.
    feedthrough : one bool an input, optional
        Whether the input acts on the outputs at once. None: inputs of hold "first" do, for their
        slope towards the next sample is not known yet.

    Returns
    -------
    StateSpace
        `status` is "estimated", or "not-determined" where the model does not predict the data at
        all; then a warning says so.

    Raises
    ------
    InvalidInput
        Shapes, entries that are not finite, an order or horizon below one, a horizon too short for
        the order.
    NotIdentifiable
        Too few samples for the order or the horizon.
    """
    _check(order, horizon, method)
    stacked = stack(data)
    through = check_feedthrough(feedthrough, stacked)
    found = realise(stacked, order, method, horizon, through)
    evaluator = Evaluator(stacked, found.matrices.order)
    values = evaluator.linear(found.matrices, through, gain=True)
    if np.isfinite(evaluator.cost(values.pack())):
        model = assemble(stacked, values, "subspace", "estimated", through)
    else:
        model = assemble(stacked, values, "subspace", "not-determined", through, (_DIVERGES,))
    return replace(model, singular_values=found.singular_values, horizon=found.horizon)


def realise(
    data: Stack,
    order: int | None,
    method: Method,
    horizon: int | None,
    feedthrough: tuple[bool, ...],
) -> Realisation:
    """The better realisation, by the determinant of its innovations, in balanced coordinates."""
    ways = ("moesp", "predictor") if method == "auto" else (method,)
    length = horizon or choose_horizon(data, order or HIGHEST_ORDER)
    _check_length(data, order or 1, length)
    best: tuple[float, Realisation] | None = None
    for way in ways:
        found = _WAYS[way](data, order, length, feedthrough)
        if len(ways) == 1:
            return found
        evaluator = Evaluator(data, found.matrices.order)
        cost = evaluator.cost(evaluator.linear(found.matrices, feedthrough, gain=True).pack())
        if best is None or cost < best[0]:
            best = cost, found
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


def _predictor(
    data: Stack, order: int | None, past: int, feedthrough: tuple[bool, ...]
) -> Realisation:
    """States from the autoregression y[k] = D u[k] + sum M_i z[k-i] + e[k].

    M_i = C (A - K C)^(i-1) [B - K D, K]. The products of C (A - K C)^j with the states are sums of
    M_(i+j) z[k-i]; terms beyond the past are negligible once M_past is.
    """
    m, p = data.n_inputs, data.n_outputs
    width = m + p
    # One sample more than the past, so that the state one sample on has its whole past as well.
    R, _ = triangular_factor(data, past + 1, _regression_order(data, past))
    lead = m + past * width
    coefficients = solve_upper(R[:lead, :lead], R[:lead, lead:])[m:].T
    padded = np.hstack([coefficients, np.zeros((p, past * width))])
    sight = np.vstack([padded[:, j * width : (j + past) * width] for j in range(past)])
    Z = R[:, m:lead]
    U, s, _ = np.linalg.svd(sight @ Z.T, full_matrices=False)
    n = order or _largest_gap(s)
    to_state = (U[:, :n].T @ sight) / np.sqrt(s[:n])[:, None]
    return _from_states(R, to_state, data, past, s, feedthrough, given=None)


def _moesp(data: Stack, order: int | None, past: int, feedthrough: tuple[bool, ...]) -> Realisation:
    """A and C from the extended observability matrix, states from the oblique projection."""
    p = data.n_outputs
    R, known, lead = _past_and_future(data, past)
    L_wy = R[known:lead, lead:]  # future outputs on the past, future inputs projected out
    reduced = np.linalg.qr(L_wy, mode="r")
    _, s, Vt = np.linalg.svd(reduced)
    n = order or _largest_gap(s)
    sight = Vt[:n].T * np.sqrt(s[:n])
    C = sight[:p]
    A = np.asarray(np.linalg.lstsq(sight[:-p], sight[p:], rcond=None)[0])
    # x = sight^+ (oblique projection) = sight^+ L_wy' L_ww'^-1 w
    oblique = solve_upper(R[known:lead, known:lead], L_wy @ np.linalg.pinv(sight).T)
    return _from_oblique(oblique, data, past, s, feedthrough, given=(A, C))


def _n4sid(data: Stack, order: int | None, past: int, feedthrough: tuple[bool, ...]) -> Realisation:
    """States from the oblique projection itself, unweighted; A, B, C, D by regression on them."""
    R, known, lead = _past_and_future(data, past)
    onto_past = solve_upper(R[known:lead, known:lead], R[known:lead, lead:])
    # the projection's rows are w' onto_past; all of w counts, not only what future inputs leave
    _, s, Vt = np.linalg.svd(np.linalg.qr(R[:lead, known:lead] @ onto_past, mode="r"))
    n = order or _largest_gap(s)
    sight = Vt[:n].T * np.sqrt(s[:n])
    return _from_oblique(
        onto_past @ np.linalg.pinv(sight).T, data, past, s, feedthrough, given=None
    )


def _past_and_future(data: Stack, past: int) -> tuple[FloatArray, int, int]:
    """R of [future inputs, past w, future outputs], where the past begins and where it ends."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    window = np.arange(2 * past * width).reshape(2 * past, width)
    history, future = window[:past], window[past:]
    columns = [future[:, :m], history, future[:, m:]]
    R, _ = triangular_factor(data, 2 * past, np.concatenate([c.ravel() for c in columns]))
    return R, past * m, past * m + past * width


def _from_oblique(
    oblique: FloatArray,
    data: Stack,
    past: int,
    singular_values: FloatArray,
    feedthrough: tuple[bool, ...],
    given: tuple[FloatArray, FloatArray] | None,
) -> Realisation:
    """From the states as combinations of the past, (past * width, n), oldest sample first."""
    n = oblique.shape[1]
    to_state = oblique.T.reshape(n, past, -1)[:, ::-1].reshape(n, -1)
    R, _ = triangular_factor(data, past + 1, _regression_order(data, past))
    return _from_states(R, to_state, data, past, singular_values, feedthrough, given)


def _from_states(
    R: FloatArray,
    to_state: FloatArray,
    data: Stack,
    past: int,
    singular_values: FloatArray,
    feedthrough: tuple[bool, ...],
    given: tuple[FloatArray, FloatArray] | None,
) -> Realisation:
    """Regress outputs and next states on states and inputs; the residuals give K.

    `R` stands for the data: its columns are [u[k], z[k-1], ..., z[k-past], y[k]].
    """
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


_WAYS = {"moesp": _moesp, "n4sid": _n4sid, "predictor": _predictor}
