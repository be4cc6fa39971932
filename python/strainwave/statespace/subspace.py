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
from typing import Literal

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
    stabilise,
    stack,
    unpack,
)

Method = Literal["auto", "moesp", "n4sid", "predictor"]

# Longest horizon. Lightly damped joints ring longer, but a longer horizon improves the starting
# value less than the prediction-error method does.
MAX_HORIZON = 40

# Highest order that the singular values can select.
MAX_ORDER = 10

_METHODS = ("moesp", "n4sid", "predictor")


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
    length = horizon or choose_horizon(factors, order or MAX_ORDER)
    matrices, singular_values = realise(factors, order, method, length, through)
    evaluator, warnings = Evaluator(data, matrices.order), list[Diagnostic]()
    if focus == "stability" and not _core.is_stable(matrices.A):
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
    """One data set and its triangular factors, by horizon."""

    def __init__(self, data: Stack) -> None:
        self.data = data
        records = _core.Innovations(1, data.n_inputs, data.samples, data.lengths)
        self.by_horizon = cache(partial(_core.Subspace, records))


def realise(
    factors: Factors,
    order: int | None,
    method: Method,
    horizon: int,
    feedthrough: tuple[bool, ...],
) -> tuple[ModelMatrices, FloatArray]:
    """Model of scaled channels with the smaller cost, balanced, and the singular values."""
    data = factors.data
    _check_length(data, order or 1, horizon)
    core, m, p = factors.by_horizon(horizon), data.n_inputs, data.n_outputs

    def realisation(way: str) -> tuple[ModelMatrices, FloatArray]:
        n, values, singular_values = core.realise(
            way, feedthrough, MIN_VARIANCE_SHARE, order=order, max_order=MAX_ORDER
        )
        return unpack(values, n, m, p), singular_values

    def cost(realisation: tuple[ModelMatrices, FloatArray]) -> float:
        evaluator = Evaluator(data, realisation[0].order)
        return evaluator.cost(evaluator.linear(realisation[0], feedthrough, gain=True))

    if method != "auto":
        return realisation(method)
    return min((realisation(way) for way in ("moesp", "predictor")), key=cost)


def check_feedthrough(feedthrough: tuple[bool, ...] | None, data: Stack) -> tuple[bool, ...]:
    """One feedthrough flag per input."""
    if feedthrough is None:
        return tuple(hold == "first" for hold in data.hold)
    if len(feedthrough) != data.n_inputs:
        raise InvalidInput(
            f"expected feedthrough for each of {data.n_inputs} inputs, got {len(feedthrough)}"
        )
    return tuple(bool(flag) for flag in feedthrough)


def choose_horizon(factors: Factors, order: int) -> int:
    """Order of an ARX model of the data by Akaike's criterion.

    One triangular factor serves all orders. With the columns [u[k], z[k-1], z[k-2], ..., y[k]], the
    rows of R below a column hold the residual of y[k] after regression on all earlier columns.
    """
    data = factors.data
    width = data.n_inputs + data.n_outputs
    # Each past sample adds `width` regressors and requires five rows for each of them.
    max_horizon = min(MAX_HORIZON, data.n_samples // (5 * width), (max(data.lengths) - 1) // 3)
    min_horizon = min(max(order + 1, 2), max(max_horizon, 1))
    if max_horizon <= min_horizon:
        return min_horizon
    R, rows = factors.by_horizon(max_horizon).regression()
    output_columns = R[:, -data.n_outputs :]
    products = np.einsum("ki,kj->kij", output_columns, output_columns)[::-1].cumsum(axis=0)[::-1]
    starts = data.n_inputs + width * np.arange(1, max_horizon + 1)
    covariance = products[starts] / rows + MIN_VARIANCE_SHARE * np.eye(data.n_outputs)
    criterion = rows * np.linalg.slogdet(covariance)[1]
    criterion += 2.0 * width * data.n_outputs * np.arange(1, max_horizon + 1)
    return max(min_horizon, 1 + int(np.argmin(criterion)))


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
