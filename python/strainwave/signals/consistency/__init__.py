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
from strainwave.signals.consistency.unexplained import is_reported, unexplained

__all__ = ["check", "doubted_torques", "torque_constants"]

_MAX_CAUSES = 3  # an input with more faults needs experiments, not guesses
_MUST_STAY = ("followed", "scale", "inertia")  # kinds that a correction may not make disappear
_MIN_GAIN = 0.75  # weight of contradictions that a cause must explain
_FREE_PENALTY = 0.5  # weight of contradictions by which a free factor must explain more
_MAX_LIKELY_CAUSES = 3  # named where no cause explains everything


def check(logs: Sequence[Log], study: Study) -> Consistency:
    """Compare all channels of all logs with one another and with the study.

    A suspicion for each cause that explains contradictions; where none explains all of them, the
    contradictions themselves, with the likely causes in order.
    """
    with one_blas_thread():
        found = list(clipped(logs, Arm.of(study.arm)))
        seen = evidence(logs, study).without([each.where for each in found])
        found.extend(_explained(seen))
    return Consistency(tuple(found))


def _explained(seen: Evidence) -> list[Suspicion]:
    """Causes one after the other, each the one that leaves the least contradictions."""
    now = observe(seen)
    chosen: list[Cause] = []
    likely: list[Suspicion] = []
    while any(o.contradicts for o in now) and len(chosen) < _MAX_CAUSES:
        ranked = _ranked(seen, now)
        if not chosen:
            likely = [cause.suspicion for cause in ranked if not cause.is_free]
        if not ranked:
            break
        chosen.append(ranked[0])
        seen = seen.corrected(ranked[0].suspicion.corrections)
        now = observe(seen)
    left = [o for o in now if o.contradicts and is_reported(o)]
    if not left:
        return [cause.suspicion for cause in chosen]
    kept = [cause.suspicion for cause in chosen if not cause.is_free]
    return [*kept, *unexplained(left, likely[:_MAX_LIKELY_CAUSES], seen.study)]


def _ranked(seen: Evidence, now: Sequence[Observation]) -> list[Cause]:
    """The causes that explain something, that which leaves least first; of equals the simplest.

    A cause without which nothing is left to compare explains nothing: what contradicted before, or
    should always be observed, and is not observed any more counts as contradicting.
    """
    before = _weight(now, now)
    weights: list[tuple[float, Cause]] = []
    for cause in causes(seen, [o for o in now if o.contradicts]):
        after = _weight(observe(seen.corrected(cause.suspicion.corrections)), now)
        if after < before - _MIN_GAIN:
            weights.append((after + _FREE_PENALTY * cause.is_free, cause))
        if after == 0.0:
            break
    return [cause for _, cause in sorted(weights, key=lambda each: each[0])]


def _weight(now: Sequence[Observation], before: Sequence[Observation]) -> float:
    lost = {(o.kind, o.where) for o in before if o.contradicts or o.kind in _MUST_STAY}
    lost -= {(o.kind, o.where) for o in now}
    return sum(o.weight for o in now if o.contradicts) + len(lost)
