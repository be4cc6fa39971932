"""Result of a search for the minimum of the objective."""

from __future__ import annotations

from dataclasses import dataclass

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace


@dataclass(frozen=True, eq=False)
class Fit:
    """Final iterate of a search."""

    objective: Objective
    z: FloatArray  # (n_unknowns,)
    cost: float  # objective with the final weights; infinite before the first iteration
    iterations: int
    converged: bool

    @property
    def space(self) -> ParameterSpace:
        """Unknowns, fixed parameters and prior."""
        return self.objective.space

    @property
    def values(self) -> Values:
        """Values of all parameters, fixed ones included."""
        return self.space.values(self.z)

    @property
    def records(self) -> list[str]:
        """Names of the records."""
        return [record.log.name for record in self.objective.records]
