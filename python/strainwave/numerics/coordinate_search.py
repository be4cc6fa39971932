"""Search for the best choice of one candidate per coordinate, one coordinate at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product

_MAX_PASSES = 4  # over the coordinates; choices are stable after two or three

Choice = tuple[int, ...]
"""Number of the candidate, from 0, of each coordinate."""


class CoordinateSearch:
    """Choices of candidates and their costs, each computed once.

    `cost_of` returns the costs of several choices. `costs` has all that were computed.
    """

    def __init__(self, cost_of: Callable[[Sequence[Choice]], Iterable[float]]) -> None:
        self.costs: dict[Choice, float] = {}
        self._cost_of = cost_of

    def evaluate(self, choices: Sequence[Choice]) -> list[float]:
        """Costs of the choices."""
        new = [choice for choice in dict.fromkeys(choices) if choice not in self.costs]
        self.costs.update(zip(new, self._cost_of(new) if new else (), strict=True))
        return [self.costs[choice] for choice in choices]

    def least(self, choices: Sequence[Choice]) -> Choice:
        """The choice of least cost, the first of several."""
        costs = self.evaluate(choices)
        return choices[costs.index(min(costs))]

    def minimise(self, starts: Sequence[Choice], counts: Sequence[int]) -> Choice:
        """Choice that no change of one coordinate improves, from the best of `starts`.

        `counts` is the number of candidates of each coordinate. A pass over the coordinates takes
        at most as many evaluations as there are candidates of all coordinates.
        """
        best = self.least(starts)
        for _ in range(_MAX_PASSES):
            previous = best
            for i, count in enumerate(counts):
                best = self.least([replaced(best, {i: k}) for k in range(count)])
            if best == previous:
                break
        return best

    def pairs(self, best: Choice, candidates: Sequence[Sequence[int]]) -> list[list[Choice]]:
        """All candidates of each pair of neighbouring coordinates, with their costs computed.

        The other coordinates are at their best. A single coordinate gives its candidates.
        """
        n = len(candidates)
        grids = []
        for block in [range(i, min(i + 2, n)) for i in range(max(1, n - 1))]:
            combinations = product(*(candidates[i] for i in block))
            grids.append([replaced(best, dict(zip(block, ks, strict=True))) for ks in combinations])
            self.evaluate(grids[-1])
        return grids


def replaced(choice: Choice, candidates: Mapping[int, int]) -> Choice:
    """A choice with other candidates of some coordinates."""
    return tuple(candidates.get(i, k) for i, k in enumerate(choice))
