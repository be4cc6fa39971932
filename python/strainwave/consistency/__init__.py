"""Logs, Study -> Consistency: whether the channels agree with one another and with the study.

Runs before any estimate. Every relation here holds for every arm of the kind, whatever its
parameters: what contradicts one is a fault of the input, and where one cause explains all that
contradicts, it is named.
"""

from __future__ import annotations

from collections.abc import Sequence

from strainwave.consistency.causes import Cause, causes
from strainwave.consistency.clipping import clipped
from strainwave.consistency.evidence import Evidence, evidence
from strainwave.consistency.observations import Observation, observe
from strainwave.consistency.unexplained import unexplained
from strainwave.cores import one_blas_thread
from strainwave.records import Consistency, Log, Study, Suspicion

__all__ = ["check"]

_MOST_CAUSES = 6  # at once; an input with more faults is no measurement
_GAIN = 0.75  # weight of contradictions that a cause must explain


def check(logs: Sequence[Log], study: Study) -> Consistency:
    """Compare all channels of all logs with one another and with the study.

    Parameters
    ----------
    logs : sequence of Log
    study : Study

    Returns
    -------
    Consistency
        With a suspicion for each cause that would explain contradictions.
    """
    with one_blas_thread():
        found = list(clipped(logs, study))
        seen = evidence(logs, study)
        found.extend(_explained(seen))
    return Consistency(tuple(found))


def _explained(seen: Evidence) -> list[Suspicion]:
    """Causes one after the other, each the one that explains most of what contradicts still."""
    found: list[Suspicion] = []
    left = _contradictions(seen)
    while left and len(found) < _MOST_CAUSES:
        best, gain = _best(seen, left)
        if best is None or gain < _GAIN:
            break
        found.append(best.suspicion)
        seen = best.mend()
        left = _contradictions(seen)
    found.extend(unexplained(seen, left))
    return found


def _contradictions(seen: Evidence) -> list[Observation]:
    return [o for o in observe(seen) if o.contradicts]


def _weight(found: Sequence[Observation]) -> float:
    return sum(o.weight for o in found)


def _best(seen: Evidence, left: Sequence[Observation]) -> tuple[Cause | None, float]:
    best: Cause | None = None
    least = before = _weight(left)
    for cause in causes(seen, left):
        after = _weight(_contradictions(cause.mend()))
        if after < least - 1e-9:
            best, least = cause, after
        if least == 0.0:
            break
    return best, before - least
