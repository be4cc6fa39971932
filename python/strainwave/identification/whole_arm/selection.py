"""What candidate models are judged by, and the one interface that they share."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

from strainwave.domain import FloatArray, TuningOptions
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import Objective
from strainwave.identification.whole_arm.solver import COARSE_GAIN, COARSE_SHARE, search_from

EVIDENT = 3.0
"""Standard deviations that speak for a settling time, an effect, or another curve."""
TRIAL = 10
"""Evaluations in which a candidate must show its gain."""


@dataclass
class Selection:
    """The setting in which a model is selected."""

    arm: Arm
    options: TuningOptions  # their evaluations grow where a candidate has some of its own
    budget: int = field(init=False)  # evaluations that the options allow a fit

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    @property
    def most(self) -> int:
        """Evaluations that may be spent in all."""
        return self.options.max_iterations

    def grant(self, evaluations: int) -> None:
        """Allow more of them."""
        self.options = replace(self.options, max_iterations=self.most + evaluations)

    def renew(self, fit: Fit) -> None:
        """Allow as many again from where a fit is."""
        most = max(self.most, fit.iterations + self.budget)
        self.options = replace(self.options, max_iterations=most)


class Candidate(Protocol):
    """A way in which the model may have more parameters, or fewer, or other starts."""

    def __call__(self, fit: Fit, selection: Selection) -> Fit:
        """The fit of that model where the records speak for it; otherwise the fit as it is."""


def trial(
    fit: Fit, objective: Objective, z: FloatArray, selection: Selection, most: int | None
) -> Fit:
    """A coarse search of another model, in a few evaluations.

    `fit`: Whose evaluations count on.
    `z` (n_unknowns,).
    `most`: Evaluations; None for all that are left.

    Raises `NotIdentifiable`: the arm cannot be simulated there.
    """
    return search_from(
        objective,
        z,
        fit.iterations,
        selection.options,
        tolerance=COARSE_GAIN,
        relative=COARSE_SHARE,
        most=most,
    )


def better(fit: Fit, other: Fit) -> Fit:
    """The other one where its gain is evident; its evaluations count in any case."""
    evident = fit.cost - other.cost > EVIDENT**2
    return other if evident else replace(fit, iterations=other.iterations)
