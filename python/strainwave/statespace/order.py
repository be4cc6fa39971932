"""Selection of the model order by held-out data and the Bayesian information criterion (BIC)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import compress

import numpy as np

from strainwave.domain import BoolArray, InputOutput, OrderSelection, SearchEnd, StateSpace
from strainwave.errors import InvalidInput
from strainwave.statespace._evaluate import fit_percent
from strainwave.statespace._scaled import Data, records_of, stack
from strainwave.statespace.pem import PemOptions, pem
from strainwave.statespace.residuals import on_data, whiteness

# Fraction of each record that is held out, at its end.
HELD_OUT_SHARE = 0.25

# Minimum number of held-out samples per state: the fit of the initial state also uses them.
MIN_HELD_OUT_SAMPLES_PER_STATE = 10

# An order is a candidate if its unexplained part of the held-out outputs exceeds the smallest one
# by at most this fraction plus this number of percentage points. The second term applies to nearly
# noise-free data.
MAX_EXCESS_SHARE = 0.05
MAX_EXCESS_POINTS = 0.1


DEFAULT_ORDERS = (2, 3, 4, 5, 6)
"""Default orders: a joint has three states, and filters add a few."""

FitOrders = Callable[[Sequence[InputOutput]], Callable[[int], StateSpace]]
"""Function from records to an order-to-model function; the models share work on the data."""


def select_order(
    data: Data,
    orders: Sequence[int] = DEFAULT_ORDERS,
    options: PemOptions | None = None,
    fit: FitOrders | None = None,
) -> OrderSelection:
    """Compare models of several orders and choose one.

    Each order is fitted to the first 75 % of every record and predicts the last 25 %, or simulates
    it if K is not estimated. Candidates are the orders whose unexplained part of the held-out
    outputs is at most 5 % larger than the smallest one. The candidates are fitted to all data. The
    candidate with the smallest BIC is chosen if its residuals are white, as BIC assumes; otherwise
    the lowest candidate is chosen.

    `fit` replaces `pem` with the given options. The result has one model per candidate, the
    held-out fits of all orders (NaN if the records are too short), and in `rule` the reason for the
    choice. Raises `InvalidInput` like `pem`, and for an empty set of orders or an order below 1.
    """
    sorted_orders = tuple(sorted(set(orders)))
    if not sorted_orders or sorted_orders[0] < 1:
        raise InvalidInput(f"expected orders of at least 1, got {tuple(orders)}")
    stack(data)
    fit = fit or (lambda records: partial(pem, records, options=options))
    kept, held_out = _split_records(data, sorted_orders[-1])
    n_outputs = records_of(data)[0].outputs.shape[1]
    fits: list[tuple[float, ...]] = [(float("nan"),) * n_outputs] * len(sorted_orders)
    is_sound = np.ones(len(sorted_orders), dtype=bool)
    model_on_all = fit(records_of(data))
    if held_out:
        model_on_kept = fit(kept)
        kept_models = [model_on_kept(order) for order in sorted_orders]
        fits = [_held_out_fit(model, held_out) for model in kept_models]
        is_sound = _converged(kept_models)
    unexplained_percent = np.array([100.0 - np.mean(percentages) for percentages in fits])
    is_candidate, reasons = is_sound, ("no data long enough to hold out", "no other converged")
    if np.isfinite(unexplained_percent[is_sound]).any():
        least = np.min(unexplained_percent[is_sound])
        limit = (1.0 + MAX_EXCESS_SHARE) * least + MAX_EXCESS_POINTS
        is_candidate = is_sound & (unexplained_percent <= limit)
        reasons = ("as good as any on held-out data", "all others are worse on held-out data")
    models = [model_on_all(order) for order in compress(sorted_orders, is_candidate)]
    candidates = list(compress(models, _converged(models)))
    chosen, rule = _choose_order(candidates, data, *reasons)
    return OrderSelection(tuple(models), tuple(fits), chosen, rule)


def _converged(models: Sequence[StateSpace]) -> BoolArray:
    """Which fits converged (n_models,); all True if none converged."""
    converged = np.array([model.status in (SearchEnd.CONVERGED, "estimated") for model in models])
    return converged if converged.any() else np.ones(len(models), dtype=bool)


def _split_records(data: Data, highest: int) -> tuple[list[InputOutput], list[InputOutput]]:
    """Kept part of every record, and held-out part of the records that are long enough."""
    kept, held_out = [], []
    for record in records_of(data):
        samples = len(record.inputs)
        cut = samples - int(HELD_OUT_SHARE * samples)
        if samples - cut >= MIN_HELD_OUT_SAMPLES_PER_STATE * highest:
            kept.append(record.window(0, cut))
            held_out.append(record.window(cut, samples))
        else:
            kept.append(record)
    return kept, held_out


def _held_out_fit(model: StateSpace, held_out: list[InputOutput]) -> tuple[float, ...]:
    stacked = stack(held_out)
    evaluator, matrices = on_data(model, stacked)
    errors = evaluator.residuals if model.K.any() else evaluator.simulation_errors
    return fit_percent(stacked.outputs, errors(matrices))[0]


def _choose_order(
    candidates: Sequence[StateSpace], data: Data, among: str, rest: str
) -> tuple[int, str]:
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
