"""How many states: what data that were held out say, and what Schwarz's criterion says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from strainwave.domain import InputOutput, OrderSelection, StateSpace
from strainwave.errors import InvalidInput
from strainwave.statespace._evaluate import fit_percent
from strainwave.statespace._stack import Data, records_of, stack
from strainwave.statespace.pem import PemOptions, pem
from strainwave.statespace.residuals import on_data, whiteness

# The last share of every record is held out.
HELD_OUT = 0.25

# Held-out samples a record needs to say anything about an order: initial state apart.
LEAST_HELD_OUT = 10

# What a model leaves of the held-out outputs, against the least any leaves, that does not matter:
# a share, and percentage points for data that are all but exact.
SHARE = 0.05
POINTS = 0.1


ORDERS = (2, 3, 4, 5, 6)
"""Those tried unless others are asked for: a joint has three states, and filters add a few."""


def select_order(
    data: Data,
    orders: Sequence[int] = ORDERS,
    options: PemOptions | None = None,
    fit: Callable[[Sequence[InputOutput], int], StateSpace] | None = None,
) -> OrderSelection:
    """Fit several orders and take one.

    Each order is fitted to the first three quarters of every record and predicts the last (or
    simulates it, if K is not estimated); then it is fitted to all of the data. Orders count that
    leave at most a twentieth more of the held-out outputs unexplained than the best does. The one
    of least BIC is taken if its residuals are white, which BIC presumes; otherwise the lowest.

    Parameters
    ----------
    data : InputOutput or sequence of InputOutput
    orders : sequence of int
    options : PemOptions, optional
    fit : callable, optional
        Records and order to a model. None: `pem` with the options.

    Returns
    -------
    OrderSelection
        Its models are those of all of the data; `rule` says why one was chosen. Held-out fits are
        NaN where the records are too short to hold anything out.

    Raises
    ------
    InvalidInput
        As `pem`; no order, or one below one.
    """
    wanted = tuple(sorted(set(orders)))
    if not wanted or wanted[0] < 1:
        raise InvalidInput(f"expected orders of at least 1, got {tuple(orders)}")
    stack(data)
    fit = fit or partial(pem, options=options)
    kept, held_out = _parts(data, wanted[-1])
    models, fits = [], []
    for order in wanted:
        if held_out:
            first = fit(kept, order)
            fits.append(_held_out_fit(first, held_out))
        else:
            fits.append((float("nan"),) * records_of(data)[0].outputs.shape[1])
        models.append(fit(records_of(data), order))
    chosen, rule = _choose(tuple(models), tuple(fits), data)
    return OrderSelection(tuple(models), tuple(fits), chosen, rule)


def _parts(data: Data, highest: int) -> tuple[list[InputOutput], list[InputOutput]]:
    """The first part of every record, and the last of those that are long enough."""
    kept, held_out = [], []
    for record in records_of(data):
        samples = len(record.inputs)
        cut = samples - int(HELD_OUT * samples)
        if samples - cut >= LEAST_HELD_OUT * highest:
            kept.append(record.window(0, cut))
            held_out.append(record.window(cut, samples))
        else:
            kept.append(record)
    return kept, held_out


def _held_out_fit(model: StateSpace, held_out: list[InputOutput]) -> tuple[float, ...]:
    stacked = stack(held_out)
    evaluator, matrices = on_data(model, stacked)
    if not model.K.any():
        return fit_percent(stacked.outputs, evaluator.simulated(matrices))
    return fit_percent(stacked.outputs, stacked.outputs - evaluator.residuals(matrices))


def _choose(
    models: tuple[StateSpace, ...], fits: tuple[tuple[float, ...], ...], data: Data
) -> tuple[int, str]:
    """The order and the reason."""
    left = np.array([100.0 - np.mean(fit) for fit in fits])
    sound = np.array([model.status in ("converged", "estimated") for model in models])
    if not sound.any():
        sound[:] = True
    if np.isfinite(left[sound]).any():
        close = sound & (left <= (1.0 + SHARE) * np.min(left[sound]) + POINTS)
        among, rest = "as good as any on held-out data", "all others are worse on held-out data"
    else:
        close, among, rest = sound, "no data long enough to hold out", "no other converged"
    candidates = [model for model, is_close in zip(models, close, strict=True) if is_close]
    names = ", ".join(str(model.order) for model in candidates)
    if len(candidates) == 1:
        return candidates[0].order, f"order {names}: {rest}"
    best = min(candidates, key=lambda model: model.bic)
    stacked = stack(data)
    evaluator, matrices = on_data(best, stacked)
    fitted = best.order * len(best.C) if best.K.any() else 0
    if whiteness(evaluator.residuals(matrices), stacked, fitted).passed:
        return best.order, f"order {best.order}: least BIC of {names} ({among})"
    lowest = candidates[0].order
    reason = "BIC has no say, as residuals are not white"
    return lowest, f"order {lowest}: the lowest of {names} ({among}); {reason}"
