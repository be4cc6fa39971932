"""Logs, Study -> Consistency: whether the channels agree with one another and with the study.

Runs before any estimate. Every relation here holds for every arm of the kind, whatever its
parameters: what contradicts one is a fault of the input, and where one cause explains all that
contradicts, it is named.
"""

from __future__ import annotations

from collections.abc import Sequence

from strainwave.domain import Consistency, Log, Study, Suspicion
from strainwave.dynamics.arm import Arm
from strainwave.numerics.parallel import one_blas_thread
from strainwave.signals.consistency.causes import Cause, causes
from strainwave.signals.consistency.clipping import clipped
from strainwave.signals.consistency.evidence import Evidence, evidence
from strainwave.signals.consistency.observations import Observation, observe
from strainwave.signals.consistency.torque_constants import doubted_torques, torque_constants
from strainwave.signals.consistency.unexplained import unexplained

__all__ = ["check", "doubted_torques", "torque_constants"]

_MOST_CAUSES = 6  # at once; an input with more faults is no measurement
_MUST_STAY = ("followed", "scale", "inertia")  # kinds of observations that a mend may not lose
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
        found = list(clipped(logs, Arm.of(study.arm)))
        seen = evidence(logs, study).without([each.where for each in found])
        found.extend(_explained(seen))
    return Consistency(tuple(found))


def _explained(seen: Evidence) -> list[Suspicion]:
    """Causes one after the other, each the one that explains most of what contradicts still."""
    found: list[Suspicion] = []
    now = observe(seen)
    while any(o.contradicts for o in now) and len(found) < _MOST_CAUSES:
        best = _best(seen, now)
        if best is None:
            break
        found.append(best.suspicion)
        seen = best.mend()
        now = observe(seen)
    found.extend(unexplained([o for o in now if o.contradicts], seen.study))
    return found


def _best(seen: Evidence, now: Sequence[Observation]) -> Cause | None:
    """The cause that leaves least contradicting; None where none explains anything.

    A cause without which there is nothing to compare any more explains nothing: what contradicted
    before, or should always be seen, and is not seen any more counts as contradicting.
    """
    best: Cause | None = None
    least = _weight(now, now) - _GAIN
    for cause in causes(seen, [o for o in now if o.contradicts]):
        after = _weight(observe(cause.mend()), now)
        if after < least - 1e-9:
            best, least = cause, after
        if least == 0.0:
            break
    return best


def _weight(now: Sequence[Observation], before: Sequence[Observation]) -> float:
    lost = {(o.kind, o.where) for o in before if o.contradicts or o.kind in _MUST_STAY}
    lost -= {(o.kind, o.where) for o in now}
    return sum(o.weight for o in now if o.contradicts) + len(lost)
