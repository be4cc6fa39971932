"""Subspace identification of state-space models, without starting value or iteration.

There are three methods. "moesp" takes A and C from the column space of the past-output MOESP method
(Verhaegen and Dewilde, Int. J. Control 56, 1992), and the states from the oblique projection of
N4SID (Van Overschee and De Moor, Automatica 30, 1994). "n4sid" takes the states from the singular
vectors of that projection, and A, B, C, D from a regression on them. "predictor" estimates the
states from a high-order ARX model, whose innovations are white under feedback too (SSARX: Jansson,
2003; PBSID_opt: Chiuso, Automatica 43, 2007). Use "predictor" for closed-loop data.

All methods use the triangular factor of the data only. Linear least squares over the whole
predictor re-estimates B, D and the initial states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Literal, NamedTuple

import numpy as np

from strainwave import _core
from strainwave.domain import STATE_SPACE_MODEL, Diagnostic, FloatArray, StateSpace
from strainwave.domain.study import Focus
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.statespace._evaluate import MIN_VARIANCE_SHARE, Evaluator, assemble
from strainwave.statespace._scaled import (
    Data,
    ModelMatrices,
    Stack,
    balance,
    innovations_gain,
    is_stable,
    stabilise,
    stabilising_gain,
    stack,
)

Method = Literal["auto", "moesp", "n4sid", "predictor"]

# Longest horizon. Lightly damped joints ring longer, but a longer horizon improves the starting
# value less than the prediction-error method does.
MAX_HORIZON = 40

# Highest order that the singular values can select.
MAX_ORDER = 10

# Smallest ratio of pivots for which the Gram matrix is used instead of a QR decomposition. The
# relative error of the weakest direction is then about 1e-16 / 1e-12, below the noise of measured
# data.
MIN_PIVOT_RATIO = 1e-6

# Rows of each block of the QR decomposition; the full Hankel matrix is never stored.
ROWS_PER_BLOCK = 2048


def subspace(
    data: Data,
    order: int | None = None,
    *,
    method: Method = "auto",
    horizon: int | None = None,
    feedthrough: tuple[bool, ...] | None = None,
    focus: Focus = "prediction",
) -> StateSpace:
    """Estimate a state-space model by a subspace method.

    - `data`: No row of the Hankel matrix spans two records.
    - `order`: None: the order with the largest ratio of successive singular values.
    - `method`: "auto" computes "moesp" and "predictor" and returns the one that predicts better.
    - `horizon`: Number of past samples, and of future samples, in a row. None: the order of an ARX
      model by Akaike's criterion.
    - `feedthrough`: Whether each input acts on the outputs without delay. None: True for inputs
      with first-order hold, because their slope depends on the next sample.
    - `focus`: "stability" reflects unstable poles into the unit circle, with a warning. Least
      squares then re-estimates B, D and the initial states.

    `status` is "estimated", or "not-determined" with a warning if the predictor diverges on the
    data.

    Raises `InvalidInput` for wrong shapes, entries that are not finite, an order or horizon below
    1, or a horizon too short for the order. Raises `NotIdentifiable` if there are too few samples
    for the order or the horizon.
    """
    for name, number in (("order", order), ("horizon", horizon)):
        if number is not None and number < 1:
            raise InvalidInput(f"expected {name} of at least 1, got {number}")
    known = ("auto", *_METHODS)
    if method not in known:
        raise InvalidInput(
            f"expected method {', '.join(known[:-1])} or {known[-1]}, got {method!r}"
        )
    return _estimate(Factors(stack(data)), order, method, horizon, feedthrough, focus)


def subspace_orders(data: Data) -> Callable[[int], StateSpace]:
    """Function from an order to `subspace(data, order, method="predictor")`.

    The data are factorised once. MOESP would double the time and rarely changes the selected order.
    """
    factors = Factors(stack(data))
    return lambda order: _estimate(factors, order, "predictor", None, None)


def _estimate(
    factors: Factors,
    order: int | None,
    method: Method,
    horizon: int | None,
    feedthrough: tuple[bool, ...] | None,
    focus: Focus = "prediction",
) -> StateSpace:
    data = factors.data
    through = check_feedthrough(feedthrough, data)
    length = horizon or choose_horizon(data, order or MAX_ORDER)
    matrices, singular_values = realise(factors, order, method, length, through)
    evaluator, warnings = Evaluator(data, matrices.order), list[Diagnostic]()
    if focus == "stability" and not is_stable(matrices.A):
        modulus = float(np.abs(np.linalg.eigvals(matrices.A)).max())
        warnings.append(Diagnostic("stability-enforced", STATE_SPACE_MODEL, modulus=modulus))
        matrices = stabilise(matrices)
    matrices = evaluator.linear(matrices, through, gain=True)
    is_finite = np.isfinite(evaluator.cost(matrices))
    status: Literal["estimated", "not-determined"]
    status = "estimated" if is_finite else "not-determined"
    if not is_finite:
        warnings.append(Diagnostic("subspace-not-determined", STATE_SPACE_MODEL))
    model = assemble(evaluator, matrices, "subspace", status, through, tuple(warnings))
    return replace(model, singular_values=singular_values, horizon=length)


class Factors:
    """Cached triangular factors and predictor directions of one data set, by horizon."""

    def __init__(self, data: Stack) -> None:
        self.data = data
        # of [u[k], z[k-1], ..., z[k-past], y[k]]
        self.regression = cache(
            lambda past: _triangular_factor(data, past + 1, _regression_order(data, past))[0]
        )
        self.predictor = cache(partial(_predictor_directions, self))


def realise(
    factors: Factors,
    order: int | None,
    method: Method,
    horizon: int,
    feedthrough: tuple[bool, ...],
) -> tuple[ModelMatrices, FloatArray]:
    """Model of scaled channels with the smaller cost, balanced, and the singular values."""
    data = factors.data
    methods = ("moesp", "predictor") if method == "auto" else (method,)
    _check_length(data, order or 1, horizon)
    realisations = [
        _realise(factors, _METHODS[way](factors, order, horizon), horizon, feedthrough)
        for way in methods
    ]

    def cost(realisation: tuple[ModelMatrices, FloatArray]) -> float:
        evaluator = Evaluator(data, realisation[0].order)
        return evaluator.cost(evaluator.linear(realisation[0], feedthrough, gain=True))

    return realisations[0] if len(realisations) == 1 else min(realisations, key=cost)


def check_feedthrough(feedthrough: tuple[bool, ...] | None, data: Stack) -> tuple[bool, ...]:
    """One feedthrough flag per input."""
    if feedthrough is None:
        return tuple(hold == "first" for hold in data.hold)
    if len(feedthrough) != data.n_inputs:
        raise InvalidInput(
            f"expected feedthrough for each of {data.n_inputs} inputs, got {len(feedthrough)}"
        )
    return tuple(bool(flag) for flag in feedthrough)


def choose_horizon(data: Stack, order: int) -> int:
    """Order of an ARX model of the data by Akaike's criterion.

    One triangular factor serves all orders. With the columns [u[k], z[k-1], z[k-2], ..., y[k]], the
    rows of R below a column hold the residual of y[k] after regression on all earlier columns.
    """
    width = data.n_inputs + data.n_outputs
    # Each past sample adds `width` regressors and requires five rows for each of them.
    max_horizon = min(MAX_HORIZON, data.n_samples // (5 * width), (max(data.lengths) - 1) // 3)
    min_horizon = min(max(order + 1, 2), max(max_horizon, 1))
    if max_horizon <= min_horizon:
        return min_horizon
    R, rows = _triangular_factor(data, max_horizon + 1, _regression_order(data, max_horizon))
    output_columns = R[:, -data.n_outputs :]
    products = np.einsum("ki,kj->kij", output_columns, output_columns)[::-1].cumsum(axis=0)[::-1]
    starts = data.n_inputs + width * np.arange(1, max_horizon + 1)
    covariance = products[starts] / rows + MIN_VARIANCE_SHARE * np.eye(data.n_outputs)
    criterion = rows * np.linalg.slogdet(covariance)[1]
    criterion += 2.0 * width * data.n_outputs * np.arange(1, max_horizon + 1)
    return max(min_horizon, 1 + int(np.argmin(criterion)))


def _regression_order(data: Stack, past: int) -> FloatArray:
    """Permutation from windows [z[k-past], ..., z[k]] to [u[k], z[k-1], ..., z[k-past], y[k]]."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    now = past * width
    lags = np.arange(past * width).reshape(past, width)[::-1].ravel()
    return np.concatenate([now + np.arange(m), lags, now + np.arange(m, width)])


def _predictor_directions(factors: Factors, past: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Singular directions of the states, from the ARX model y[k] = D u[k] + sum M_i z[k-i] + e[k].

    Returns the matrix whose leading directions give the states, its left singular vectors and its
    singular values.

    M_i = C (A - K C)^(i-1) [B - K D, K]. C (A - K C)^j times the state is the sum of M_(i+j)
    z[k-i]. Terms beyond the past are neglected.
    """
    m, p = factors.data.n_inputs, factors.data.n_outputs
    width = m + p
    R = factors.regression(past)
    lead = m + past * width
    coefficients = _solve_upper(R[:lead, :lead], R[:lead, lead:])[m:].T
    block_rows = np.zeros((past, p, past * width))
    for j in range(past):
        block_rows[j, :, : (past - j) * width] = coefficients[:, j * width :]
    rows = block_rows.reshape(past * p, past * width)
    # a square triangular factor has the same left vectors and a faster decomposition
    U, s, _ = np.linalg.svd(_qr_factor(R[:lead, m:lead] @ rows.T).T)
    return rows, U, s


def _past_and_future_factor(data: Stack, past: int) -> tuple[FloatArray, slice]:
    """Triangular factor of [future inputs, past w, future outputs], and the columns of the past."""
    m, width = data.n_inputs, data.n_inputs + data.n_outputs
    window = np.arange(2 * past * width).reshape(2 * past, width)
    history, future = window[:past], window[past:]
    columns = [future[:, :m], history, future[:, m:]]
    R, _ = _triangular_factor(data, 2 * past, np.concatenate([c.ravel() for c in columns]))
    return R, slice(past * m, past * m + past * width)


class _States(NamedTuple):
    """States by their coefficients over the past, newest sample first."""

    to_state: FloatArray  # (n, past * width)
    singular_values: FloatArray
    given: tuple[FloatArray, FloatArray] | None = None  # A and C; None: by regression on the states


def _predictor_states(factors: Factors, order: int | None, past: int) -> _States:
    rows, vectors, s = factors.predictor(past)
    n = order or _largest_gap(s)
    return _States((vectors[:, :n].T @ rows) / np.sqrt(s[:n])[:, None], s)


def _moesp_states(factors: Factors, order: int | None, past: int) -> _States:
    """A and C from the extended observability matrix, states from the oblique projection."""
    p, (R, history) = factors.data.n_outputs, _past_and_future_factor(factors.data, past)
    # future outputs on the past, with the future inputs projected out
    L_wy = R[history, history.stop :]
    _, s, Vt = np.linalg.svd(np.linalg.qr(L_wy, mode="r"))
    n = order or _largest_gap(s)
    observability = Vt[:n].T * np.sqrt(s[:n])
    C = observability[:p]
    A = np.asarray(np.linalg.lstsq(observability[:-p], observability[p:], rcond=None)[0])
    # x = O^+ (oblique projection) = O^+ L_wy' L_ww'^-1 w
    oblique = _solve_upper(R[history, history], L_wy @ np.linalg.pinv(observability).T)
    return _States(_newest_first(oblique, past), s, given=(A, C))


def _n4sid_states(factors: Factors, order: int | None, past: int) -> _States:
    """States from the unweighted oblique projection."""
    R, history = _past_and_future_factor(factors.data, past)
    onto_past = _solve_upper(R[history, history], R[history, history.stop :])
    # the projection acts on w itself, not on w after removal of the future inputs
    _, s, Vt = np.linalg.svd(np.linalg.qr(R[: history.stop, history] @ onto_past, mode="r"))
    n = order or _largest_gap(s)
    observability = Vt[:n].T * np.sqrt(s[:n])
    return _States(_newest_first(onto_past @ np.linalg.pinv(observability).T, past), s)


def _newest_first(oblique: FloatArray, past: int) -> FloatArray:
    """State coefficients (n, past * width) from (past * width, n) with the oldest sample first."""
    n = oblique.shape[1]
    return oblique.T.reshape(n, past, -1)[:, ::-1].reshape(n, -1)


_METHODS = {"moesp": _moesp_states, "n4sid": _n4sid_states, "predictor": _predictor_states}


def _realise(
    factors: Factors, states: _States, past: int, feedthrough: tuple[bool, ...]
) -> tuple[ModelMatrices, FloatArray]:
    """Regress outputs and next states on states and inputs; K follows from the residuals.

    The factor R of [u[k], z[k-1], ..., z[k-past], y[k]] represents the data. It has one sample more
    than the past, so the next state also has a full past.
    """
    data, R, to_state = factors.data, factors.regression(past), states.to_state
    m, p = data.n_inputs, data.n_outputs
    lead = m + past * (m + p)
    n = len(to_state)
    u, y = R[:, :m], R[:, lead:]
    x = R[:, m:lead] @ to_state.T
    # For the next state, [u[k], y[k]] is the newest sample and the oldest sample drops out.
    next_x = np.hstack([u, y, R[:, m : lead - m - p]]) @ to_state.T
    has_feedthrough = np.array(feedthrough)
    D = np.zeros((p, m))
    if states.given is None:
        AB = _regression(np.hstack([x, u]), next_x)
        CD = _regression(np.hstack([x, u[:, has_feedthrough]]), y)
        A, B, C = AB[:, :n], AB[:, n:], CD[:, :n]
        D[:, has_feedthrough] = CD[:, n:]
    else:
        A, C = states.given
        B = _regression(u, next_x - x @ A.T)
        D[:, has_feedthrough] = _regression(u[:, has_feedthrough], y - x @ C.T)
    residuals = np.hstack([next_x - x @ A.T - u @ B.T, y - x @ C.T - u @ D.T])
    noise = residuals.T @ residuals / max(data.n_samples, 1)
    noise[n:, n:] += MIN_VARIANCE_SHARE * np.eye(p)
    K, innovation = innovations_gain(A, C, noise[:n, :n], noise[:n, n:], noise[n:, n:])
    K = stabilising_gain(A, C, K, innovation)
    matrices = ModelMatrices(A, B, C, D, K, initial_states=np.zeros((len(data.lengths), n)))
    return balance(matrices), states.singular_values


def _regression(regressors: FloatArray, targets: FloatArray) -> FloatArray:
    """Minimum-norm least-squares solution M of targets = regressors M'."""
    return np.asarray(np.linalg.lstsq(regressors, targets, rcond=1e-12)[0].T, dtype=np.float64)


def _largest_gap(singular_values: FloatArray) -> int:
    """Order after which the ratio of successive singular values is largest."""
    s = singular_values[: MAX_ORDER + 1]
    s = np.maximum(s, 1e-14 * s[0])
    return 1 + int(np.argmax(s[:-1] / s[1:])) if len(s) > 1 else 1


def _check_length(data: Stack, order: int, horizon: int) -> None:
    """Check that the horizon suffices for the order and the records for the horizon."""
    p, width = data.n_outputs, data.n_inputs + data.n_outputs
    needed = 1 - (-order // p)
    # Rows of a Hankel matrix of 2 * horizon samples per row.
    rows = sum(max(length - 2 * horizon + 1, 0) for length in data.lengths)
    if horizon < needed or rows < horizon * width:
        if data.n_samples > 4 * (needed + 1) * width and horizon < needed:
            raise InvalidInput(f"expected a horizon of at least {needed}, got {horizon}")
        raise NotIdentifiable(
            f"{data.n_samples} samples in {len(data.lengths)} records are too few for a model of "
            f"order {order} with a horizon of {horizon} samples"
        )


def _triangular_factor(data: Stack, depth: int, order: FloatArray) -> tuple[FloatArray, int]:
    """Triangular factor R with R'R = Z'Z, and the number of rows of the block-Hankel matrix Z.

    Row k of Z is [z[k], ..., z[k + depth - 1]] with z = [u, y]. The displacement structure gives
    Z'Z, and R is its Cholesky factor. If Z'Z is ill-conditioned, a blocked QR decomposition of Z is
    used.

    `depth`: Number of samples in a row of Z.
    `order`: Permutation of the columns of Z.
    """
    lengths = list(data.lengths)
    gram, rows = _core.hankel_gram(data.inputs, data.outputs, lengths, depth, order.tolist())
    try:
        R = np.linalg.cholesky(gram).T
        pivots = np.diagonal(R)
        if pivots.min() >= MIN_PIVOT_RATIO * pivots.max():
            return np.asarray(R), rows
    except np.linalg.LinAlgError:
        pass
    return _qr_factor(_blocked_qr(data, depth)[:, order]), rows


def _solve_upper(R: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of R x = right for triangular R; the minimum-norm solution if R is singular."""
    pivots = np.abs(np.diagonal(R))
    if pivots.min() > MIN_PIVOT_RATIO * pivots.max():
        return np.asarray(np.linalg.solve(R, right))
    return np.asarray(np.linalg.lstsq(R, right, rcond=1e-12)[0], dtype=np.float64)


def _blocked_qr(data: Stack, depth: int) -> FloatArray:
    z = np.ascontiguousarray(np.hstack([data.inputs, data.outputs]))
    width = z.shape[1]
    R = np.zeros((0, depth * width))
    for record in data.rows():
        windows = np.lib.stride_tricks.sliding_window_view(z[record].ravel(), depth * width)
        windows = windows[::width]
        for start in range(0, len(windows), ROWS_PER_BLOCK):
            R = _qr_factor(np.vstack([R, windows[start : start + ROWS_PER_BLOCK]]))
    return R


def _qr_factor(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(matrix, mode="r"))
