"""Why an iterative search ended."""

from __future__ import annotations

from enum import StrEnum


class SearchEnd(StrEnum):
    """Why a search ended; the values are the words of the result file."""

    CONVERGED = "converged"  # the predicted decrease is below the tolerance
    STALLED = "stalled"  # a decrease is predicted, but no step achieves it
    NO_DESCENT = "no-descent"  # the same, and the predicted decrease is large
    EVALUATION_LIMIT = "iteration-limit"
    BOUND = "at-bounds"  # at a minimum, with an unknown at a limit of its range

    @property
    def is_minimum(self) -> bool:
        """Whether the last point is a minimum within the accuracy of a rough objective."""
        return self in (SearchEnd.CONVERGED, SearchEnd.STALLED, SearchEnd.BOUND)
