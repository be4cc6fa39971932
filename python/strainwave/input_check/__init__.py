"""Input check: consistency of the channels with each other and with the study.

The input check runs before any fit. Each relation that it tests holds for all parameter values of
the arm, so a violation indicates a fault of the input. If one cause explains all contradictions,
the check reports that cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    Clause,
    Consistency,
    Log,
    Place,
    Relation,
    Study,
    Suspicion,
    channel_parts,
)
from strainwave.dynamics.arm import Arm
from strainwave.input_check.evidence import Evidence, collect_evidence
from strainwave.input_check.hypothesis import MIN_SHARE_OF_GAIN, Hypothesis, UnexplainedEvidence
from strainwave.input_check.input_hypotheses import propose_hypotheses
from strainwave.input_check.observations import (
    EXPECTED,
    compute_observations,
    is_of_link,
    measure_clipping,
    measure_standing_encoders,
    worst_relations,
)
from strainwave.input_check.torque_fit import compare_urdf_masses, report_impossible_links
from strainwave.input_check.torque_rows import EFFORTS
from strainwave.input_check.torque_search import search_explanations
from strainwave.numerics.parallel import one_blas_thread

__all__ = ["check_consistency"]

_OF_TORQUES = ("torque-fit", "torque-sensor")
# Maximum number of combined causes. More simultaneous faults require separate experiments.
_MAX_CAUSES = 3
# Kinds of observations that must remain available after a correction.
_REQUIRED_KINDS = ("explained-share", "scale", "inertia")
# Kinds that are not observed without the record, the channel or the meaning of a fault.
_MAY_BE_MISSING = ("torque-fit", "friction", "presence")
# Weight of a signal that its prediction does not explain; no other observation is available.
_UNEXPLAINED_WEIGHT = 2.0
# Minimum decrease of the total contradiction weight for a cause to be accepted.
_MIN_EXPLAINED_WEIGHT = 0.75
# Weight added to a cause with an estimated factor, so that structured causes take precedence.
_ESTIMATED_FACTOR_PENALTY = 0.5
# Number of likely causes reported if no cause explains all contradictions.
_MAX_LIKELY_CAUSES = 3


# Minimum explained share of a link sensor's variance; short records of fault-free arms reach 0.8.
_MIN_EXPLAINED_SHARE = 0.5
# Ratio of unexplained variances from which torques contradict the arm without a cause.
_LARGE_RATIO = 2.0
# Causes listed after the likely causes.
_GENERAL_CODES = ("swapped-channels", "wrong-unit", "wrong-sign")


def check_consistency(logs: Sequence[Log], study: Study) -> Consistency:
    """Compare all channels of all logs with each other and with the study.

    Returns all relations, and one suspicion per cause that explains contradictions. If the causes
    do not explain all contradictions, also returns the remaining contradictions with the likely
    causes, most likely first. Warnings are about values of the study that are only a prior.
    """
    with one_blas_thread():
        arm = Arm.of(study.arm)
        clippings = list(measure_clipping(logs, arm))
        encoders = list(measure_standing_encoders(logs, arm))
        clipped = [suspicion for _, suspicion in clippings if suspicion is not None]
        standing = [suspicion for _, suspicion in encoders if suspicion is not None]
        clipped_channels = [p.channel for each in clipped for p in each.places if p.channel]
        unknown = [place.experiments for each in standing for place in each.places]
        suspicions = clipped + standing
        # the relations between torques and motion hold for the arm alone, and for known angles
        bare = [
            log
            for log in logs
            if log.experiment.payload is None
            and not any(not records or log.name in records for records in unknown)
        ]
        unclipped = collect_evidence(bare, study).without(clipped_channels)
        explanations = search_explanations(unclipped)
        unclipped = replace(unclipped, best_fit=_best_fit(explanations))
        observations = tuple(compute_observations(unclipped))
        suspicions.extend(_explain_contradictions(unclipped, observations, explanations or ()))
        warnings = tuple(report_impossible_links(study.arm))
        warnings += () if suspicions else tuple(compare_urdf_masses(unclipped))
    of_sensors = (relation for relation, _ in clippings + encoders)
    relations = (*of_sensors, *worst_relations(observations))
    return Consistency(tuple(suspicions), relations, warnings, _unchecked(logs, relations))


def _best_fit(explanations: Sequence[Hypothesis] | None) -> tuple[float, float] | None:
    """Cost of the best explanation, and tolerance up to which others are as good."""
    if not explanations:
        return None if explanations is None else (np.inf, 0.0)
    gain = explanations[0].gain.mean if explanations[0].gain else 0.0
    return explanations[0].cost, float(np.exp((1.0 - MIN_SHARE_OF_GAIN) * gain)) - 1.0


def _unchecked(logs: Sequence[Log], relations: Sequence[Relation]) -> tuple[str, ...]:
    """Channels of the logs that occur in no relation with other channels.

    The relations of sensors and torques compare them with the motor angles.
    """
    compared = {r.place.channel for r in relations if r.kind not in ("clipped", "readings")}
    joints = {channel_parts(r.place.channel or "")[1] for r in relations if r.kind == "inertia"}
    if any(r.kind == "torque-fit" for r in relations):
        joints |= {channel_parts(name)[1] for log in logs for name in log.channels}
    references = {r.place.channel for r in relations if r.kind == "reference"}
    compared |= {name.replace("theta_m", "ref") for name in references if name is not None}
    names = dict.fromkeys(name for log in logs for name in log.channels)
    motors = {f"{kind}{i}" for kind in ("theta_m", *EFFORTS[:2]) for i in joints}
    return tuple(name for name in names if name not in compared | motors)


def _explain_contradictions(
    evidence: Evidence, observations: Sequence[Relation], explanations: tuple[Hypothesis, ...]
) -> list[Suspicion]:
    """Select hypotheses greedily: each step takes the one that leaves the fewest contradictions."""
    chosen: list[Suspicion] = []
    structured: list[Suspicion] = []  # those of `chosen` that hold if contradictions remain
    likely: list[str] = []
    while any(_needs_cause(o, evidence) for o in observations) and len(chosen) < _MAX_CAUSES:
        contradictions = tuple(o for o in observations if not o.is_consistent)
        ranked = _rank(UnexplainedEvidence(evidence, contradictions, explanations), observations)
        if not chosen:
            likely = [each.code for each in ranked if not each.has_estimated_factor]
        if not ranked:
            break
        best = ranked[0]
        least = _weigh(evidence, observations, best) if best.rivals else 0.0
        equal = (r for r in best.rivals if _weigh(evidence, observations, r) <= least)
        rival = next(equal, None)
        named = [best] if rival is None else [best, rival]
        # the same at another place, or the same prediction
        if rival is not None and (best.kind == rival.kind or np.isclose(best.cost, rival.cost)):
            named = [best.undecided(rival), rival.undecided(best)]
        chosen.extend(each.suspicion(evidence.study) for each in named)
        if not best.has_estimated_factor or best.moves_frames:
            structured.append(best.suspicion(evidence.study))
        evidence = best.corrected(evidence)
        observations = tuple(compute_observations(evidence))
    remaining = [o for o in observations if not o.is_consistent and _is_reported(o)]
    if not remaining:
        return chosen
    likely = likely[:_MAX_LIKELY_CAUSES]
    return [*structured, *report_remaining(remaining, likely)]


def _needs_cause(each: Relation, evidence: Evidence) -> bool:
    """Whether a contradiction starts the search for causes, which takes time for chains.

    Friction alone can reduce the explained share of a motor signal; the torques of chains are
    tested by their common fit.
    """
    is_searched = evidence.arm.has_planar_program or each.kind in _OF_TORQUES
    return not each.is_consistent and (is_searched or _is_reported(each))


def _rank(case: UnexplainedEvidence, now: Sequence[Relation]) -> list[Hypothesis]:
    """Hypotheses that reduce the contradictions, by remaining weight, then by simplicity."""
    limit = sum(map(_weight, case.contradictions)) - _MIN_EXPLAINED_WEIGHT
    weights: list[tuple[float, Hypothesis]] = []
    for each in propose_hypotheses(case):
        after = _weigh(case.evidence, now, each, limit)
        if after < limit:
            weights.append((after + _ESTIMATED_FACTOR_PENALTY * each.has_estimated_factor, each))
            # observations of chains take time; the best cause is enough
            if not case.evidence.arm.has_planar_program:
                limit = min(limit, after + _ESTIMATED_FACTOR_PENALTY)
        if after == 0.0 and not each.moves_frames:  # any fault of the motors can look like frames
            break
    return [each for _, each in sorted(weights, key=lambda pair: pair[0])]


def _weight(each: Relation) -> float:
    return _UNEXPLAINED_WEIGHT if each.kind == "explained-share" else 1.0


def _weigh(
    evidence: Evidence, now: Sequence[Relation], each: Hypothesis, limit: float = np.inf
) -> float:
    """Weight of the contradictions that a hypothesis leaves, up to `limit`.

    An observation that it removes counts as a contradiction if it contradicted before or its kind
    is in `_REQUIRED_KINDS`. Without a record, signals can be explained less well than with it.
    """
    known = {(o.kind, o.place) for o in now if not o.is_consistent}
    has_fit = any(o.kind == "torque-fit" for o in now)
    missing = {(o.kind, o.place) for o in now if _is_required(o, each, has_fit=has_fit)}
    weight = 0.0
    for after in compute_observations(each.corrected(evidence)):
        key = after.kind, after.place
        missing.discard(key)
        is_worse = each.excluded and after.kind == "explained-share" and key not in known
        weight += 0.0 if is_worse or after.is_consistent else _weight(after)
        if weight >= limit:
            return weight
    return weight + len(missing)


def _is_required(o: Relation, each: Hypothesis, *, has_fit: bool) -> bool:
    """Whether an observation must remain available after a correction.

    If the torques are compared with one arm, the equation of a single joint may be missing: its
    columns can be linearly dependent with the correct geometry.
    """
    is_share = o.kind == "explained-share" and o.place.channel is None
    if o.kind in _MAY_BE_MISSING or (has_fit and (is_share or o.kind == "inertia")):
        return False
    if each.excluded and (o.is_consistent or set(each.excluded) & set(o.place.experiments)):
        return False
    is_compared = not (each.moves_frames and is_of_link(o))
    return is_compared and (not o.is_consistent or o.kind in _REQUIRED_KINDS)


def _is_reported(each: Relation) -> bool:
    """Whether a contradiction is reported without a cause.

    A low explained share of a motor signal is not reported, because friction and servo limits
    can cause it. Link sensors follow the motion in every fault-free record.
    """
    if each.kind == "torque-fit":  # other relations exclude all better explanations
        return each.measured > _LARGE_RATIO
    if each.kind != "explained-share":
        return True
    return is_of_link(each) and each.measured < _MIN_EXPLAINED_SHARE


def report_remaining(
    contradictions: Sequence[Relation], likely: Sequence[str]
) -> Iterator[Suspicion]:
    """Suspicions for the remaining contradictions, one per channel.

    `likely` has the codes of the causes that explain most of the contradictions, most likely first.
    """
    experiments = tuple(
        Clause(f"isolate/{code}", number=number)
        for number, code in enumerate(dict.fromkeys([*likely, *_GENERAL_CODES]), start=1)
    )
    remedy = Clause("remedy/experiments", experiments=experiments)
    by_place: dict[Place, Relation] = {}
    for each in sorted(contradictions, key=lambda o: o.kind == "explained-share"):
        by_place.setdefault(replace(each.place, joint=None), each)
    for place, each in by_place.items():
        is_factor = each.kind not in ("delay", "drift", "input-delay", "explained-share")
        yield Suspicion(
            code="wrong-sign" if is_factor and each.measured < 0.0 else EXPECTED[each.kind].code,
            places=(place,),
            clause=Clause(
                f"contradiction/{each.kind}", place=place, value=each.measured, joint=each.joint
            ),
            remedy_clause=remedy,
            factor=each.measured if is_factor else None,
        )
