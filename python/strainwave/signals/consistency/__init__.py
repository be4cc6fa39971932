"""Input check: consistency of the channels with each other and with the study.

The input check runs before any fit. Each relation that it tests holds for all parameter values of
the arm, so a violation indicates a fault of the input. If one cause explains all contradictions,
the check reports that cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from strainwave.domain import Consistency, Log, Relation, Study, Suspicion, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.numerics.parallel import one_blas_thread
from strainwave.signals.consistency.clipping import measure_clipping
from strainwave.signals.consistency.evidence import BestFit, Evidence, collect_evidence
from strainwave.signals.consistency.hypothesis import MIN_SHARE_OF_GAIN, Case, Hypothesis
from strainwave.signals.consistency.input_hypotheses import propose_hypotheses
from strainwave.signals.consistency.motors import EFFORTS
from strainwave.signals.consistency.observations import (
    Observation,
    compute_observations,
    relations_of,
)
from strainwave.signals.consistency.remaining_contradictions import (
    is_reported,
    report_remaining_contradictions,
)
from strainwave.signals.consistency.torque_constants import (
    find_doubtful_torque_constant,
    suspect_torque_constants,
)
from strainwave.signals.consistency.torque_search import search_explanations
from strainwave.signals.consistency.urdf_masses import compare_urdf_masses, report_impossible_links

__all__ = ["check_consistency", "find_doubtful_torque_constant", "suspect_torque_constants"]

_OF_TORQUES = ("torque-fit", "torque-prediction", "torque-sensor")
# Rivals of a cause that are named with it.
_MAX_RIVALS = 1
# Maximum number of combined causes. More simultaneous faults require separate experiments.
_MAX_CAUSES = 3
# Kinds of observations that must remain available after a correction.
_REQUIRED_KINDS = ("explained-share", "scale", "inertia")
# Kinds that are not observed without the record, the channel or the meaning of a fault.
_MAY_BE_MISSING = ("torque-fit", "friction", "presence")
# Minimum decrease of the total contradiction weight for a cause to be accepted.
_MIN_EXPLAINED_WEIGHT = 0.75
# Weight added to a cause with an estimated factor, so that structured causes take precedence.
_ESTIMATED_FACTOR_PENALTY = 0.5
# Number of likely causes reported if no cause explains all contradictions.
_MAX_LIKELY_CAUSES = 3


def check_consistency(logs: Sequence[Log], study: Study) -> Consistency:
    """Compare all channels of all logs with each other and with the study.

    Returns all relations, and one suspicion per cause that explains contradictions. If the causes
    do not explain all contradictions, also returns the remaining contradictions with the likely
    causes, most likely first. Warnings are about values of the study that are only a prior.
    """
    with one_blas_thread():
        clippings = list(measure_clipping(logs, Arm.of(study.arm)))
        suspicions = [suspicion for each in clippings for suspicion in each.suspicions]
        clipped_channels = [p.channel for each in suspicions for p in each.places if p.channel]
        # the relations between torques and motion hold for the arm alone
        bare = [log for log in logs if log.experiment.payload is None]
        unclipped = collect_evidence(bare, study).without(clipped_channels)
        explanations = search_explanations(unclipped)
        unclipped = replace(unclipped, best_fit=_best_fit(explanations))
        observations = tuple(compute_observations(unclipped))
        suspicions.extend(_explain_contradictions(unclipped, observations, explanations or ()))
        warnings = tuple(report_impossible_links(study.arm))
        warnings += () if suspicions else tuple(compare_urdf_masses(unclipped))
    relations = (*(each.relation for each in clippings), *relations_of(observations))
    return Consistency(tuple(suspicions), relations, warnings, _unchecked(logs, relations))


def _best_fit(explanations: Sequence[Hypothesis] | None) -> BestFit | None:
    if not explanations:
        return None if explanations is None else BestFit(np.inf, 0.0)
    gain = explanations[0].gain.mean if explanations[0].gain else 0.0
    return BestFit(explanations[0].cost, float(np.exp((1.0 - MIN_SHARE_OF_GAIN) * gain)) - 1.0)


def _unchecked(logs: Sequence[Log], relations: Sequence[Relation]) -> tuple[str, ...]:
    """Channels of the logs that occur in no relation but that of clipped samples.

    The relations of sensors and torques compare them with the motor angles.
    """
    compared = {r.place.channel for r in relations if r.kind != "clipped"}
    joints = {channel_parts(r.place.channel or "")[1] for r in relations if r.kind == "inertia"}
    if any(r.kind == "torque-fit" for r in relations):
        joints |= {channel_parts(name)[1] for log in logs for name in log.channels}
    references = {r.place.channel for r in relations if r.kind == "reference"}
    compared |= {name.replace("theta_m", "ref") for name in references if name is not None}
    names = dict.fromkeys(name for log in logs for name in log.channels)
    motors = {f"{kind}{i}" for kind in ("theta_m", *EFFORTS[:2]) for i in joints}
    return tuple(name for name in names if name not in compared | motors)


def _explain_contradictions(
    evidence: Evidence, observations: Sequence[Observation], explanations: tuple[Hypothesis, ...]
) -> list[Suspicion]:
    """Select causes greedily: each step takes the cause that leaves the fewest contradictions."""
    chosen: list[Suspicion] = []
    structured: list[Suspicion] = []  # those of `chosen` that hold if contradictions remain
    likely: list[str] = []
    while any(_needs_cause(o, evidence) for o in observations) and len(chosen) < _MAX_CAUSES:
        ranked = _rank_causes(evidence, observations, explanations)
        if not chosen:
            likely = [cause.code for cause in ranked if not cause.has_estimated_factor]
        if not ranked:
            break
        rivals = _equal_rivals(evidence, observations, ranked[0])
        chosen.extend(each.suspicion(evidence.study) for each in (ranked[0], *rivals))
        if not ranked[0].has_estimated_factor or ranked[0].moves_frames:
            structured.append(ranked[0].suspicion(evidence.study))
        evidence = ranked[0].corrected(evidence)
        observations = tuple(compute_observations(evidence))
    remaining = [o for o in observations if o.contradicts and is_reported(o)]
    if not remaining:
        return chosen
    return [
        *structured,
        *report_remaining_contradictions(remaining, likely[:_MAX_LIKELY_CAUSES], evidence.study),
    ]


def _needs_cause(each: Observation, evidence: Evidence) -> bool:
    """Whether a contradiction starts the search for causes, which takes time for chains.

    Friction alone can reduce the explained share of a motor signal; the torques of chains are
    tested by their common fit.
    """
    is_searched = evidence.arm.has_planar_program or each.kind in _OF_TORQUES
    return each.contradicts and (is_searched or is_reported(each))


def _rank_causes(
    evidence: Evidence, now: Sequence[Observation], explanations: tuple[Hypothesis, ...]
) -> list[Hypothesis]:
    """Causes that reduce the contradictions, ordered by remaining weight, then by simplicity.

    An observation counts as a contradiction if the correction removes it and it contradicted
    before or its kind is in `_REQUIRED_KINDS`.
    """
    before = _contradiction_weight(now, now, np.inf)
    limit = before - _MIN_EXPLAINED_WEIGHT
    weights: list[tuple[float, Hypothesis]] = []
    case = Case(evidence, tuple(o for o in now if o.contradicts), explanations)
    for cause in propose_hypotheses(case):
        after = _weight_after(evidence, now, cause, limit)
        if after < limit:
            weights.append((after + _ESTIMATED_FACTOR_PENALTY * cause.has_estimated_factor, cause))
            # observations of chains take time; the best cause is enough
            if not evidence.arm.has_planar_program:
                limit = min(limit, after + _ESTIMATED_FACTOR_PENALTY)
        if after == 0.0 and not cause.moves_frames:  # any fault of the motors can look like frames
            break
    return [cause for _, cause in sorted(weights, key=lambda each: each[0])]


def _equal_rivals(
    evidence: Evidence, now: Sequence[Observation], cause: Hypothesis
) -> list[Hypothesis]:
    """The first rival of a cause that leaves no more contradictions than the cause does."""
    least = _weight_after(evidence, now, cause, np.inf) if cause.rivals else 0.0
    equal = (r for r in cause.rivals if _weight_after(evidence, now, r, np.inf) <= least)
    return [*islice(equal, _MAX_RIVALS)]


def _weight_after(
    evidence: Evidence, now: Sequence[Observation], cause: Hypothesis, limit: float
) -> float:
    """Weight of the contradictions that a cause leaves.

    Without a record, signals can be explained less well than with it.
    """
    after = compute_observations(cause.corrected(evidence))
    if cause.excluded:
        before = {(o.kind, o.place) for o in now if o.contradicts}
        after = (o for o in after if o.kind != "explained-share" or (o.kind, o.place) in before)
    return _contradiction_weight(after, _tested(now, cause), limit)


def _tested(now: Sequence[Observation], cause: Hypothesis) -> list[Observation]:
    """Observations that must remain available after a correction."""
    left_out = set(cause.excluded)
    return [
        o
        for o in now
        if not (cause.moves_frames and o.is_of_link)
        and not (left_out and (left_out & set(o.place.experiments) or not o.contradicts))
    ]


def _contradiction_weight(
    now: Iterable[Observation], before: Sequence[Observation], limit: float
) -> float:
    """Total weight of the contradictions in `now`, plus 1 per missing observation of `before`.

    The sum ends at `limit`. If the torques are compared with one arm, the equation of a single
    joint may be missing: its columns can be linearly dependent with the correct geometry.
    """
    may_be_missing = any(o.kind == "torque-fit" for o in before)
    missing = {
        (o.kind, o.place)
        for o in before
        if (o.contradicts or o.kind in _REQUIRED_KINDS)
        and not (may_be_missing and o.is_of_joint_equation)
        and o.kind not in _MAY_BE_MISSING
    }
    weight = 0.0
    for each in now:
        missing.discard((each.kind, each.place))
        weight += each.weight * each.contradicts
        if weight >= limit:
            return weight
    return weight + len(missing)
