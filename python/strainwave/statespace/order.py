"""How many states: what data that were held out say, and what Schwarz's criterion says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, InputOutput, OrderSelection, StateSpace
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


FitOrders = Callable[[Sequence[InputOutput]], Callable[[int], StateSpace]]
"""Records to a function from an order to the model of that order: work on the data is shared."""


def select_order(
    data: Data,
    orders: Sequence[int] = ORDERS,
    options: PemOptions | None = None,
    fit: FitOrders | None = None,
) -> OrderSelection:
    """Compare models of several orders and choose one.

    Each order is fitted to the first three quarters of every record and predicts the last quarter,
    or simulates it if K is not estimated. The orders that leave at most a twentieth more of the
    held-out outputs unexplained than the best order are candidates, and are fitted to all of the
    data. The candidate of least BIC is chosen if its residuals are white, which BIC presumes;
    otherwise the lowest candidate.

    `fit` replaces `pem` with the given options. The result has one model per candidate, held-out
    fits of every order (NaN if the records are too short to hold anything out), and in `rule` the
    reason for the choice. Raises `InvalidInput` like `pem`, and for no order or one below 1.
    """
    wanted = tuple(sorted(set(orders)))
    if not wanted or wanted[0] < 1:
        raise InvalidInput(f"expected orders of at least 1, got {tuple(orders)}")
    stack(data)
    fit = fit or (lambda records: partial(pem, records, options=options))
    kept, held_out = _parts(data, wanted[-1])
    fits: list[tuple[float, ...]] = [(float("nan"),) * records_of(data)[0].outputs.shape[1]]
    fits *= len(wanted)
    is_sound = np.ones(len(wanted), dtype=bool)
    of_all = fit(records_of(data))
    if held_out:
        of_first = fit(kept)
        first = [of_first(order) for order in wanted]
        fits = [_held_out_fit(model, held_out) for model in first]
        is_sound = _sound(first)
    left = np.array([100.0 - np.mean(each) for each in fits])
    if np.isfinite(left[is_sound]).any():
        close = is_sound & (left <= (1.0 + SHARE) * np.min(left[is_sound]) + POINTS)
        among, rest = "as good as any on held-out data", "all others are worse on held-out data"
    else:
        close, among, rest = is_sound, "no data long enough to hold out", "no other converged"
    models = [of_all(order) for order, is_close in zip(wanted, close, strict=True) if is_close]
    is_usable = _sound(models)
    candidates = [model for model, usable in zip(models, is_usable, strict=True) if usable]
    chosen, rule = _choose(candidates, data, among, rest)
    return OrderSelection(tuple(models), tuple(fits), chosen, rule)


def _sound(models: Sequence[StateSpace]) -> BoolArray:
    """(n_models,) whether each fit converged; all of them where none did."""
    sound = np.array([model.status in ("converged", "estimated") for model in models])
    return sound if sound.any() else np.ones(len(models), dtype=bool)


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


def _choose(candidates: Sequence[StateSpace], data: Data, among: str, rest: str) -> tuple[int, str]:
    """The order and the reason."""
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
