"""Warnings of a run: select those that apply to the final table, and group them by cause."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from strainwave.domain.estimates import Diagnostic, Parameter, Place
from strainwave.domain.final_table import Decision
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.keys import Key
from strainwave.domain.ranges import implausible_joints
from strainwave.domain.stage_results import StageResults
from strainwave.domain.verdict import Verdict, model_defects

_NUMBER = re.compile(
    r"(?<![\w.])(?<!joint )(?<!motor )(?<!link )-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
)
"""A number in a message, except joint numbers ("joint 2") and digits in names ("u1")."""
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
    warnings += model_defects(results)
    for size in implausible_joints(results.study.arm, [d.parameter for d in decisions]):
        warnings.append(Diagnostic.at("implausible-size", Place(joint=size.joint), size.text))
    has_unpredicted = any(check.unexplained for check in results.checks if not check.of_drive)
    if results.whole_arm is not None and not verdict.validated.elastic and not has_unpredicted:
        where = str(results.study.path)
        warnings.append(Diagnostic("elastic-not-validated", where, missing_validation(results)))
    return merge_by_cause(dict.fromkeys(warnings))


def rejection_warnings(decisions: Iterable[Decision]) -> Iterator[Diagnostic]:
    """Yield one warning for each reason for rejection, with the rejected values."""
    by_reason: dict[str, list[Decision]] = {}
    for decision in decisions:
        if decision.rejected:
            by_reason.setdefault(decision.rejected, []).append(decision)
    for reason, rows in by_reason.items():
        values = ", ".join(f"{d.parameter.label} = {d.raw:.4g}" for d in rows if d.raw is not None)
        joint_numbers = {d.parameter.joint for d in rows}
        joints = ", ".join(str(n) for n in sorted(n for n in joint_numbers if n is not None))
        where = f"joint {joints}" if joints and None not in joint_numbers else "arm"
        if len(rows) == 1:
            where = str(_place_of(rows[0].parameter))
        yield Diagnostic("rejected", where, f"{reason}; rejected values: {values}")


def missing_validation(results: StageResults) -> str:
    """Explain why the elastic model is not validated, and what to record.

    Returns a clause without a full stop.
    """
    motion_checks = [check for check in results.checks if not check.of_drive]
    record = (
        'record steps under the servo, or a PRBS, as use = "check", with the angle and the voltage '
        "of every motor and the servo's references"
    )
    if results.whole_arm is None:
        return "the run has no whole-arm fit, which predicts the motion"
    if not motion_checks:
        return f"no check record can be simulated; {record}"
    unpredicted = ", ".join(check.experiment for check in motion_checks if check.unexplained)
    if unpredicted:
        return f"the whole-arm fit does not predict {unpredicted}"
    names = ", ".join(dict.fromkeys(check.experiment for check in motion_checks))
    return f"the predictions of {names} do not depend on the gear stiffness; {record}"


def merge_by_cause(warnings: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Merge warnings about several records with the same cause into one.

    Two warnings have the same cause if their codes and messages are equal except for numbers. The
    merged message gives the range of each number. Only warnings whose place is one record, or one
    joint in one record, are merged. The order is that of the first warning of each cause.
    """
    groups: dict[tuple[str, ...], list[Diagnostic]] = {}
    for warning in warnings:
        record = _record(warning)
        cause = (
            (warning.code, warning.where, warning.message)
            if record is None
            else (warning.code, _NUMBER.sub("#", warning.message.replace(record, "")))
        )
        groups.setdefault(cause, []).append(warning)
    return tuple(_merge(group) for group in groups.values())


def _record(warning: Diagnostic) -> str | None:
    """Record that the warning concerns; None unless it is exactly one."""
    place = warning.place
    return place.experiments[0] if place is not None and place.is_one_record else None


def _merge(group: Sequence[Diagnostic]) -> Diagnostic:
    """Merge warnings with one cause into one that gives all places and the ranges of numbers."""
    first = group[0]
    joints_by_record: dict[Key, None] = {}
    messages = []
    for warning in group:
        record, place = _record(warning), warning.place
        if record is None or place is None:
            return first
        joints_by_record[record, place.joint] = None
        messages.append(warning.message.replace(record, ""))
    names = tuple(dict.fromkeys(record for record, _ in joints_by_record))
    if len(joints_by_record) == 1:
        return replace(first, experiments=names)
    where = ", ".join(
        name if joint is None else f"{name} (joint {joint})" for name, joint in joints_by_record
    )
    pieces = _NUMBER.split(messages[0])
    numbers = zip(*(_NUMBER.findall(message) for message in messages), strict=True)
    message = pieces[0]
    for values, piece in zip(numbers, pieces[1:], strict=True):
        smallest, largest = min(values, key=float), max(values, key=float)
        message += (smallest if smallest == largest else f"{smallest} to {largest}") + piece
    return Diagnostic(first.code, where, message, names)


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
