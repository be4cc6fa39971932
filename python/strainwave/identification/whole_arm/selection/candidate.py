"""Common interface and decision rule of candidate models."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

from strainwave.domain import WholeArmOptions
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.identification.whole_arm.search.solver import (
    COARSE_RELATIVE_TOLERANCE,
    COARSE_TOLERANCE,
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
    """Arm, options and evaluation budget of a model selection."""

    arm: Arm
    options: WholeArmOptions  # `max_iterations` grows when a candidate is granted evaluations
    budget: int = field(init=False)  # evaluations that the user allows for one fit

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    @property
    def max_evaluations(self) -> int:
        """Maximum total number of evaluations."""
        return self.options.max_iterations

    def grant(self, evaluations: int) -> None:
        """Increase the maximum number of evaluations."""
        self.options = replace(self.options, max_iterations=self.max_evaluations + evaluations)

    def renew(self, fit: Fit) -> None:
        """Allow the full budget again, counted from the evaluations of `fit`."""
        max_iterations = max(self.max_evaluations, fit.iterations + self.budget)
        self.options = replace(self.options, max_iterations=max_iterations)


class Candidate(Protocol):
    """A change of the model: added parameters, removed parameters or another starting value."""

    def __call__(self, fit: Fit, selection: Selection) -> Fit:
        """Return the fit of the changed model if the data support it, otherwise `fit`."""


def run_trial(start: Fit, selection: Selection, max_evaluations: int | None) -> Fit:
    """Run a coarse search of another model.

    `max_evaluations` limits the evaluations of the trial; None allows all remaining ones. Raises
    `NotIdentifiable` if the arm cannot be simulated at `start`.
    """
    return search_minimum(
        start,
        selection.options,
        tolerance=COARSE_TOLERANCE,
        relative=COARSE_RELATIVE_TOLERANCE,
        max_evaluations=max_evaluations,
    )


def select_better(fit: Fit, other: Fit) -> Fit:
    """Return `other` if it reduces the cost significantly, otherwise `fit` with its evaluations."""
    is_significant = fit.cost - other.cost > MIN_SIGNIFICANCE_STDS**2
    return other if is_significant else replace(fit, iterations=other.iterations)
