"""From a start to the minimum: rounds of robust weights, first coarse and then fine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np

from strainwave.domain import FloatArray, TuningOptions
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Objective
from strainwave.numerics.trust_region import Linearised, minimise

COARSE_GAIN, COARSE_SHARE = (
    1.0,
    2e-3,
)  # predicted gain at a rough end, in units of the cost and as a share
_FINE, _GUESSED = 1e-2, 2e-2  # the same of the fit itself, and by weights that are guessed
_ROUNDS = 4  # of new weights; the third seldom moves anything
_ROUGH_ROUNDS = 8  # of the same far from the minimum
_SETTLED = 0.2  # relative change of the weights
_SMALLER = 0.7  # of what they were: errors that show a search had ended early
_NEAR = 1e-8  # damping of a search that is close


Progress = Callable[[int, int], None]
"""Called with the number of an evaluation, and the most there may be."""
_progress: ContextVar[Progress] = ContextVar("_progress", default=lambda _k, _most: None)


@contextmanager
def reported(progress: Progress | None) -> Iterator[None]:
    """Let searches begun inside say how far they are."""
    if progress is None:
        yield
        return
    before = _progress.set(progress)
    try:
        yield
    finally:
        _progress.reset(before)


def coarse_search(objective: Objective, start: FloatArray, options: TuningOptions) -> Fit:
    """By weights that are guessed, and then by those that each search shows.

    A search from far ends early by weights that its own errors made too lenient: new ones follow
    for as long as the errors become much smaller.

    `start` (n_unknowns,).
    """
    first = search_from(objective, start, 0, options, tolerance=COARSE_GAIN, relative=_GUESSED)
    if not first.converged or first.iterations >= options.max_iterations:
        return replace(first, converged=False)
    return _reweighted(first, options)


def resumed_coarse_search(
    objective: Objective, z: FloatArray, spent: int, options: TuningOptions
) -> Fit:
    """On from a rough fit whose records or unknowns have become others.

    `z` (n_unknowns,).
    `spent`: Evaluations so far.
    """
    return _reweighted(search_from(objective, z, spent, options, tolerance=COARSE_GAIN), options)


def _reweighted(fit: Fit, options: TuningOptions) -> Fit:
    """On from a rough fit, by new weights for as long as they become much smaller."""
    fit = replace(fit, objective=fit.objective.reweighted(fit.z))
    search = partial(search_from, options=options, tolerance=COARSE_GAIN, relative=COARSE_SHARE)
    for _ in range(_ROUGH_ROUNDS):
        fit = search(fit.objective, fit.z, fit.iterations)
        renewed = fit.objective.reweighted(fit.z)
        spent = not fit.converged or fit.iterations >= options.max_iterations
        if spent or not _smaller(fit.objective, renewed):
            break
        fit = replace(fit, objective=renewed)
    return fit


def fine_search(objective: Objective, z: FloatArray, spent: int, options: TuningOptions) -> Fit:
    """Least squares and new weights in turn until the weights settle; `polished` ends the search.

    `z` is near the minimum. The integrator's step error is corrected twice, where the first search
    ends and near the minimum.
    """
    fit = search_from(objective, z, spent, options, tolerance=_FINE, relative=_GUESSED)
    if spent >= options.max_iterations:  # what it costs is known, and no more
        return replace(fit, iterations=spent, converged=False)
    if fit.converged and fit.iterations < options.max_iterations:
        fit = refined(_corrected(fit), options, tolerance=_FINE)
    if not fit.converged or fit.iterations >= options.max_iterations:
        return replace(fit, converged=False)
    return refined(_corrected(fit), options)  # where the step's errors are now those of the end


def _corrected(fit: Fit) -> Fit:
    """With the step's errors, and weights, of where the fit is."""
    return replace(fit, objective=fit.objective.corrected(fit.z).reweighted(fit.z))


def refined(fit: Fit, options: TuningOptions, tolerance: float = COARSE_GAIN) -> Fit:
    """The last rounds of `fine_search`, from a point so near that weights and step errors hold.

    By the usual tolerance the result is within a standard deviation of the minimum: the choice of
    the model's parameters needs no more.
    """
    search = partial(search_from, options=options, tolerance=tolerance)
    for _ in range(_ROUNDS):
        if fit.iterations >= options.max_iterations:
            return replace(fit, converged=False)
        fit = search(fit.objective, fit.z, fit.iterations, damping=_NEAR)
        renewed = fit.objective.reweighted(fit.z)
        if not fit.converged or _settled(fit.objective, renewed):
            break
        fit = replace(fit, objective=renewed)
    return fit


def polished(fit: Fit, options: TuningOptions) -> Fit:
    """The minimum itself, by the weights of a refined fit."""
    if not fit.converged or fit.iterations >= options.max_iterations:
        return fit
    return search_from(
        fit.objective, fit.z, fit.iterations, options, tolerance=_FINE, damping=_NEAR
    )


def search_from(
    objective: Objective,
    z: FloatArray,
    spent: int,
    options: TuningOptions,
    *,
    tolerance: float,
    relative: float = 0.0,
    damping: float = 1e-3,
    most: int | None = None,
) -> Fit:
    """The minimum by given weights.

    `z` (n_unknowns,): To start from.
    `spent`: Evaluations so far.
    `tolerance, relative, damping`: See `minimise`.
    `most`: Evaluations, if fewer than are left.

    Raises `NotIdentifiable`: the arm cannot be simulated there.
    """
    left = options.max_iterations - spent
    evaluation = count(spent + 1)

    def linearise(x: FloatArray) -> Linearised | None:
        _progress.get()(next(evaluation), options.max_iterations)
        return objective.linearise(x)

    found = minimise(
        linearise,
        z,
        objective.space,
        tolerance=tolerance,
        relative=relative,
        damping=damping,
        max_evaluations=max(1, left if most is None else min(left, most)),
    )
    if found is None:
        raise NotIdentifiable("the whole-arm fit cannot simulate the arm where it starts")
    return Fit(objective, found.x, found.at.cost, spent + found.evaluations, found.converged)


def _settled(old: Objective, new: Objective) -> bool:
    pairs = zip(old.weights, new.weights, strict=True)
    return all(np.max(np.abs(np.log(b.deviation / a.deviation))) < _SETTLED for a, b in pairs)


def _smaller(old: Objective, new: Objective) -> bool:
    pairs = zip(old.weights, new.weights, strict=True)
    return any(np.min(b.deviation / a.deviation) < _SMALLER for a, b in pairs)
