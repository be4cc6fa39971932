"""Common interface and decision rule of candidate models."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

from strainwave.domain import FloatArray, TuningOptions
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.solver import (
    COARSE_RELATIVE_TOLERANCE,
    COARSE_TOLERANCE,
    search_minimum,
)

EVIDENT = 3.0
"""Standard deviations from which a settling time, an effect or another curve is significant.

The minimum cost reduction is its square.
"""
TRIAL = 10
"""Maximum evaluations of the trial fit of a candidate."""


@dataclass
class Selection:
    """Arm, options and evaluation budget of a model selection."""

    arm: Arm
    options: TuningOptions  # `max_iterations` grows when a candidate is granted evaluations
    budget: int = field(init=False)  # evaluations that the user allows for one fit

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    @property
    def most(self) -> int:
        """Maximum total number of evaluations."""
        return self.options.max_iterations

    def grant(self, evaluations: int) -> None:
        """Increase the maximum number of evaluations."""
        self.options = replace(self.options, max_iterations=self.most + evaluations)

    def renew(self, fit: Fit) -> None:
        """Allow the full budget again, counted from the evaluations of `fit`."""
        most = max(self.most, fit.iterations + self.budget)
        self.options = replace(self.options, max_iterations=most)


class Candidate(Protocol):
    """A change of the model: added parameters, removed parameters or another starting value."""

    def __call__(self, fit: Fit, selection: Selection) -> Fit:
        """Return the fit of the changed model if the data support it, otherwise `fit`."""


def trial(
    fit: Fit, objective: Objective, z: FloatArray, selection: Selection, most: int | None
) -> Fit:
    """Run a coarse search of another model from `z` (n_unknowns,).

    The evaluation count continues from that of `fit`. `most` is the maximum number of evaluations;
    None allows all that are left. Raises `NotIdentifiable` if the arm cannot be simulated at `z`.
    """
    return search_minimum(
        objective,
        z,
        fit.iterations,
        selection.options,
        tolerance=COARSE_TOLERANCE,
        relative=COARSE_RELATIVE_TOLERANCE,
        max_evaluations=most,
    )


def better(fit: Fit, other: Fit) -> Fit:
    """Return `other` if it reduces the cost significantly, otherwise `fit` with its evaluations."""
    evident = fit.cost - other.cost > EVIDENT**2
    return other if evident else replace(fit, iterations=other.iterations)
