"""Suspicions for contradictions that no single cause explains, with experiments to isolate it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from strainwave.domain import Clause, Place, Suspicion
from strainwave.signals.consistency.observations import EXPECTED, Observation

# Minimum explained share of a link sensor's variance; short records of fault-free arms reach 0.8.
_MIN_EXPLAINED_SHARE = 0.5
# Ratio of unexplained variances from which torques contradict the arm without a cause.
_LARGE_RATIO = 2.0
# Causes listed after the likely causes.
_GENERAL_CODES = ("swapped-channels", "wrong-unit", "wrong-sign")


def is_reported(each: Observation) -> bool:
    """Whether a contradiction is reported without a cause.

    A low explained share of a motor signal is not reported, because friction and servo limits
    can cause it. Link sensors follow the motion in every fault-free record.
    """
    if each.kind == "torque-prediction":
        return False  # friction and slow motion can hide the torques of the links
    if each.kind == "torque-fit":  # other relations exclude all better explanations
        return each.value > _LARGE_RATIO
    if each.kind != "explained-share":
        return True
    return each.is_of_link and each.value < _MIN_EXPLAINED_SHARE


def report_remaining_contradictions(
    contradictions: Sequence[Observation], likely: Sequence[str]
) -> Iterator[Suspicion]:
    """Suspicions for the remaining contradictions, one per channel.

    `likely` has the codes of the causes that explain most of the contradictions, most likely first.
    """
    experiments = tuple(
        Clause(f"isolate/{code}", number=number)
        for number, code in enumerate(dict.fromkeys([*likely, *_GENERAL_CODES]), start=1)
    )
    remedy = Clause("remedy/experiments", experiments=experiments)
    by_place: dict[Place, Observation] = {}
    for each in sorted(contradictions, key=lambda o: o.kind == "explained-share"):
        by_place.setdefault(replace(each.place, joint=None), each)
    for place, each in by_place.items():
        is_factor = each.kind not in ("delay", "drift", "input-delay", "explained-share")
        yield Suspicion(
            code="wrong-sign" if is_factor and each.value < 0.0 else EXPECTED[each.kind].code,
            places=(place,),
            clause=Clause(
                f"contradiction/{each.kind}", place=place, value=each.value, joint=each.joint
            ),
            remedy_clause=remedy,
            factor=each.value if is_factor else None,
        )
