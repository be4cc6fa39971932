"""Result of one run: the results of all stages, the final table, the verdict and the warnings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from strainwave.display import Displayed
from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.final_table import Decision, decide
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.messages import Clause, Place, merge_clauses
from strainwave.domain.ranges import size_warnings
from strainwave.domain.stage_results import StageResults
from strainwave.domain.verdict import (
    MIN_STIFFNESS_EFFECT,
    Verdict,
    compute_verdict,
    model_defects,
    stiffness_effects,
)

_STAGE_CODES = frozenset({"not-identifiable", "implausible", "equivalent-stiffness"})
"""Codes of warnings about one parameter in one stage."""


def published_warnings(
    results: StageResults, decisions: Sequence[Decision], verdict: Verdict
) -> tuple[Diagnostic, ...]:
    """Collect the warnings of a run, one for each cause.

    A warning about a parameter is omitted if a later stage decides that parameter. It remains in
    the warnings of its stage. Each reason for rejection has one warning.
    """
    warnings = [*_current_warnings(results, decisions), *rejection_warnings(decisions)]
    defects = tuple(model_defects(results))
    warnings += defects
    checks = results.checks
    for channel in dict.fromkeys(name for check in checks for name in check.channels):
        fits = {c.experiment: c.fit_percent[channel] for c in checks if channel in c.channels}
        if not any(map(math.isfinite, fits.values())):  # it has no fit in any check record
            places = tuple(map(Place.in_records, fits))
            warnings.append(Diagnostic("nothing-to-predict", places, "rest", channel=channel))
    warnings += size_warnings(results.study.arm, [d.parameter for d in decisions])
    if results.whole_arm is not None and not verdict.validated.elastic and not defects:
        warnings.append(missing_validation(results))
    return merge_by_cause(dict.fromkeys(warnings))


def rejection_warnings(decisions: Iterable[Decision]) -> Iterator[Diagnostic]:
    """Yield one warning for each reason for rejection, with the rejected values."""
    by_reason: dict[Clause, list[Decision]] = {}
    for decision in decisions:
        if decision.rejected:
            by_reason.setdefault(decision.rejected, []).append(decision)
    for reason, rows in by_reason.items():
        values = tuple(
            Clause("rejected-value", label=d.parameter.label, value=d.raw)
            for d in rows
            if d.raw is not None
        )
        joints = sorted({d.parameter.joint or 0 for d in rows})
        places = tuple(Place(joint=number) for number in joints)
        if 0 in joints:
            places = (Place(part="arm"),)
        if len(rows) == 1:
            places = (_place_of(rows[0].parameter),)
        yield Diagnostic("rejected", places, reason=reason, values=values)


def missing_validation(results: StageResults) -> Diagnostic:
    """Warn why the elastic model is not validated, and what to record."""
    defects = [Clause("defect", places=d.places, defect=d.clause) for d in model_defects(results)]
    reasons = {
        "no-fit": results.whole_arm is None,
        "defect": bool(defects),
        "no-check": all(e.use != "check" for e in results.study.experiments),
        "no-effect": True,
    }
    reason = next(name for name, holds in reasons.items() if holds)
    place = Place(file=str(results.study.path))
    clauses = {"defects": tuple(defects), "unused": tuple(_unused_checks(results))}
    return Diagnostic("elastic-not-validated", place, reason, **clauses)


def _unused_checks(results: StageResults) -> Iterator[Clause]:
    """Yield check records that are not simulated, and gears that no other check record loads."""
    simulated = {check.experiment for check in results.checks if not check.of_drive}
    records_by_reason: dict[str, list[str]] = {}
    for experiment in results.study.experiments:
        if experiment.use == "check" and experiment.name not in simulated:
            reason = results.not_simulated.get(experiment.name, "a defect of the data")
            records_by_reason.setdefault(reason, []).append(experiment.name)
    for reason, records in records_by_reason.items():
        yield Clause("check/not-simulated", records=tuple(records), reason=reason)
    for joint, (effect, channel, record) in stiffness_effects(results).items():
        if simulated and not channel:
            yield Clause("check/rest", joint=joint)
        elif simulated and effect < MIN_STIFFNESS_EFFECT:
            yield Clause(
                "check/insensitive",
                joint=joint,
                channel=channel,
                record=record,
                effect=effect,
                limit=MIN_STIFFNESS_EFFECT,
            )


def merge_by_cause(warnings: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Merge warnings about several records with the same cause into one.

    Two warnings have the same cause if they differ only in measurements; the merged warning has
    the range of each. Only warnings whose place is one record, or one joint in one record, are
    merged. The order is that of the first warning of each cause.
    """
    groups: dict[Diagnostic | tuple[str, Clause], list[Diagnostic]] = {}
    for warning in warnings:
        is_of_record = warning.place is not None and warning.place.is_one_record
        cause = (warning.code, warning.clause.shape) if is_of_record else warning
        groups.setdefault(cause, []).append(warning)
    merged = []
    for group in groups.values():
        places = tuple(dict.fromkeys(place for each in group for place in each.places))
        merged.append(group[0])
        if len(group) > 1 and len(places) > 1:
            clause = merge_clauses([each.clause for each in group])
            merged[-1] = Diagnostic.of(group[0].code, places, clause)
    return tuple(merged)


def _current_warnings(results: StageResults, decisions: Sequence[Decision]) -> Iterator[Diagnostic]:
    """Yield all warnings except those about parameters that a later stage decides."""
    decision_by_place = {_place_of(d.parameter): d for d in decisions}
    tuned_warnings = set(results.whole_arm.warnings) if results.whole_arm is not None else set()
    for warning in results.stage_warnings:
        if warning.code in _STAGE_CODES and warning not in tuned_warnings:
            decision = decision_by_place.get(warning.place) if warning.place else None
            if decision is None:  # the whole-arm fit has a stiffness curve instead
                is_stiffness = warning.place is not None and warning.place.parameter == STIFFNESS
                is_superseded = results.whole_arm is not None and is_stiffness
            else:
                has_value = decision.parameter.value is not None
                is_superseded = decision.parameter.stage == "tuned"
                is_superseded = is_superseded or (warning.code == "not-identifiable" and has_value)
            if is_superseded:
                continue
        yield warning


def _place_of(p: Parameter) -> Place:
    return Place(joint=p.joint, parameter=p.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(StageResults, Displayed):
    """Result of one run; result.json and the report are rendered from it.

    The conclusions from the results of the stages are computed once, at construction.
    """

    created: str  # ISO 8601, UTC
    version: str
    timing_s: Mapping[str, float]
    decisions: tuple[Decision, ...] = field(init=False)  # the final table, each with its reason
    verdict: Verdict = field(init=False)
    warnings: tuple[Diagnostic, ...] = field(init=False)  # that apply to the final table

    def __post_init__(self) -> None:
        """Draw the conclusions."""
        decisions = decide(self)
        verdict = compute_verdict(self, decisions)
        object.__setattr__(self, "decisions", decisions)
        object.__setattr__(self, "verdict", verdict)
        object.__setattr__(self, "warnings", published_warnings(self, decisions, verdict))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The final table: parameters of the whole arm first, then joint by joint.

        The latest stage that estimates a parameter decides it.
        """
        return tuple(decision.parameter for decision in self.decisions)

    @property
    def reason(self) -> str | None:
        """Reasons why the run is not determined, in one sentence; None if it is determined."""
        return "; ".join(self.verdict.reasons) or None
