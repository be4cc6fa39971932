"""Result of a search for the minimum of the objective."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, SearchEnd
from strainwave.domain.keys import Values
from strainwave.domain.results.estimates import physical_range
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace

# distance to a bound, relative to half the range, that counts as at the bound
_BOUND_TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class Fit:
    """Iterate of a search: its result, or the start of another one."""

    objective: Objective
    z: FloatArray  # (n_unknowns,)
    cost: float  # objective with the final weights; infinite before the first iteration
    iterations: int
    end: SearchEnd = SearchEnd.EVALUATION_LIMIT  # of the last search; no minimum before it

    @classmethod
    def at(cls, objective: Objective, z: FloatArray) -> Fit:
        """The start of a search at z (n_unknowns,)."""
        return cls(objective, z, np.inf, 0)

    def restart(self, objective: Objective, z: FloatArray) -> Fit:
        """The start of a search with another objective; its evaluations count from this fit."""
        return replace(self, objective=objective, z=z, cost=np.inf, end=SearchEnd.EVALUATION_LIMIT)

    def with_unknowns(self, space: ParameterSpace, starts: Values | None = None) -> Fit:
        """The start of a search with other unknowns, at `starts` and the values of this fit."""
        z = space.coordinates(self.values | (starts or {}))
        return self.restart(self.objective.replace_unknowns(space), z)

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

    @property
    def at_bounds(self) -> BoolArray:
        """Unknowns (n_unknowns,) at a bound of their search range that is no physical zero."""
        at_upper = self._is_near(self.space.upper - self.z)
        return np.asarray((at_upper | self._is_near(self.z - self.space.lower)) & ~self.at_zero)

    @property
    def at_zero(self) -> BoolArray:
        """Unknowns (n_unknowns,) at the lower bound of a range that begins at zero."""
        may_vanish = [physical_range(name) == "non-negative" for name, _ in self.space.keys]
        return np.asarray(self._is_near(self.z - self.space.lower) & np.array(may_vanish))

    def _is_near(self, distance: FloatArray) -> BoolArray:
        margin = 0.5 * _BOUND_TOLERANCE * (self.space.upper - self.space.lower)
        return np.asarray(distance < margin)
