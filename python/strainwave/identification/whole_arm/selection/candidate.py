"""Candidate models: test a further unknown, add it, fit, keep or drop it.

`best_trial` fits, `select_better` keeps or drops, `revise` repeats both until nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from strainwave.domain import LawChoice, WholeArmOptions
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import (
    COARSE_RELATIVE_TOLERANCE,
    fine_search,
    search_minimum,
)

MIN_SIGNIFICANCE_STDS = 3.0
"""Standard deviations from which a settling time, an effect or another curve is significant.

The minimum cost reduction is its square.
"""
MAX_CANDIDATE_EVALUATIONS = 10
"""Maximum evaluations of the trial fit of a candidate."""


@dataclass
class Selection:
    """Arm, options and evaluation budget of a model selection, and its choices of gear laws."""

    arm: Arm
    options: WholeArmOptions  # `max_iterations` grows when a candidate is granted evaluations
    budget: int = field(init=False)  # evaluations that the user allows for one fit
    # of the joints whose gear law the fit selects; `arm` has the laws
    law_choices: dict[int, LawChoice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    def is_budget_exhausted(self, fit: Fit) -> bool:
        """Whether no evaluations are left after those of `fit`."""
        return fit.iterations >= self.options.max_iterations

    def allow(self, evaluations: int) -> None:
        """Raise the maximum total number of evaluations, if it is lower."""
        max_iterations = max(self.options.max_iterations, evaluations)
        self.options = replace(self.options, max_iterations=max_iterations)

    def renew(self, fit: Fit) -> None:
        """Allow the full budget again, counted from the evaluations of `fit`."""
        self.allow(fit.iterations + self.budget)


Candidate = Callable[[Fit, Selection], Fit]
"""A change of the model: added parameters, removed parameters or another starting value.

It returns the fit of the changed model if the data support it, otherwise the fit itself.
"""


def run_trial(start: Fit, selection: Selection, max_evaluations: int | None) -> Fit:
    """Run a coarse search of another model.

    `max_evaluations` limits the evaluations of the trial; None allows all remaining ones. Raises
    `NotIdentifiable` if the arm cannot be simulated at `start`.
    """
    return search_minimum(
        start,
        selection.options,
        relative=COARSE_RELATIVE_TOLERANCE,
        max_evaluations=max_evaluations,
    )


def best_trial(starts: Iterable[Fit], search: Callable[[Fit], Fit]) -> Fit | None:
    """The search of least cost from several starts; None if the arm can be simulated at none."""
    trials = []
    for start in starts:
        with suppress(NotIdentifiable):
            trials.append(search(start))
    return min(trials, key=lambda trial: trial.cost, default=None)


def revise(
    fit: Fit,
    change: Callable[[Fit], Fit | None],
    search: Callable[[Fit, WholeArmOptions], Fit],
    selection: Selection,
) -> Fit:
    """Search from each change of the model until `change` finds none.

    `change` tests unknowns and returns the start with those that the data support, or without one
    that they do not support.
    """
    while (start := change(fit)) is not None:
        fit = search(start, selection.options)
    return fit


def refit_without(values: Mapping[Key, float], fit: Fit, selection: Selection) -> Fit:
    """Repeat a fine fit with unknowns fixed at `values`; the fit itself if there are none."""
    if not values:
        return fit
    return fine_search(fit.with_unknowns(fit.space.fix_values(values)), selection.options)


def select_better(fit: Fit, other: Fit) -> Fit:
    """Return `other` if it reduces the cost significantly, otherwise `fit` with its evaluations."""
    is_significant = fit.cost - other.cost > MIN_SIGNIFICANCE_STDS**2
    return other if is_significant else replace(fit, iterations=other.iterations)
