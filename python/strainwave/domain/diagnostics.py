"""Warnings of a run: select those that apply to the final table, and group them by cause."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.final_table import Decision
from strainwave.domain.identification import Identification, model_defects
from strainwave.domain.ranges import implausible_joints

_NUMBER = re.compile(
    r"(?<![\w.])(?<!joint )(?<!motor )(?<!link )-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])"
)
"""A number in a message, except joint numbers ("joint 2") and digits in names ("u1")."""
_IN_JOINT = re.compile(r", joint (\d+)$")
_STAGE_CODES = frozenset({"not-identifiable", "implausible", "equivalent-stiffness"})
"""Codes of warnings about one parameter in one stage."""


def published_warnings(found: Identification) -> tuple[Diagnostic, ...]:
    """Collect the warnings of a run, one for each cause.

    A warning about a parameter is omitted if a later stage decides that parameter. It remains in
    the warnings of its stage. Each reason for rejection has one warning.
    """
    decisions = found.decisions
    warnings = [*_current_warnings(found, decisions), *rejections(decisions)]
    warnings += model_defects(found)
    for size in implausible_joints(found.study.arm, found.parameters):
        warnings.append(Diagnostic("implausible-size", f"joint {size.joint}", size.text))
    has_unpredicted = any(check.unexplained for check in found.checks if not check.of_drive)
    if found.tuned is not None and not found.verdict.validated.elastic and not has_unpredicted:
        where = str(found.study.path)
        warnings.append(Diagnostic("elastic-not-validated", where, not_exercised(found)))
    experiments = [e.name for e in found.study.experiments]
    return grouped(dict.fromkeys(warnings), experiments)


def rejections(decisions: Iterable[Decision]) -> Iterator[Diagnostic]:
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
            where = _place_name(rows[0].parameter)
        yield Diagnostic("rejected", where, f"{reason}; what it gave does not count: {values}")


def not_exercised(found: Identification) -> str:
    """Explain why the elastic model is not validated, and what to record.

    Returns a clause without a full stop.
    """
    motion_checks = [check for check in found.checks if not check.of_drive]
    record = (
        'record steps under the servo, or a PRBS, as use = "check", with the angle and the voltage '
        "of every motor and the servo's references"
    )
    if found.tuned is None:
        return "there is no whole-arm fit to predict with"
    if not motion_checks:
        return f"no check record can be simulated; {record}"
    unpredicted = ", ".join(check.experiment for check in motion_checks if check.unexplained)
    if unpredicted:
        return f"the whole-arm fit does not predict {unpredicted}"
    names = ", ".join(dict.fromkeys(check.experiment for check in motion_checks))
    return f"{names} would be predicted alike with other gear stiffness; {record}"


def grouped(warnings: Iterable[Diagnostic], experiments: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Merge warnings about several records with the same cause into one.

    Two warnings have the same cause if their codes and messages are equal except for numbers. The
    merged message gives the range of each number. Only warnings about a record in `experiments`, or
    about one of its joints ("prbs-j1, joint 1"), are merged. The order is that of the first warning
    of each cause.
    """
    groups: dict[tuple[str, ...], list[Diagnostic]] = {}
    for each in warnings:
        cause = (
            (each.code, _NUMBER.sub("#", _without_place(each)))
            if _record(each) in experiments
            else (each.code, each.where, each.message)
        )
        groups.setdefault(cause, []).append(each)
    return tuple(_merge(group, experiments) for group in groups.values())


def _record(warning: Diagnostic) -> str:
    return _IN_JOINT.sub("", warning.where)


def _without_place(warning: Diagnostic) -> str:
    return warning.message.replace(_record(warning), "")


def _merge(group: Sequence[Diagnostic], experiments: Sequence[str]) -> Diagnostic:
    first = group[0]
    if _record(first) not in experiments:
        return first
    names = tuple(dict.fromkeys(_record(each) for each in group))
    places = tuple(dict.fromkeys(each.where for each in group))
    if len(places) == 1:
        return replace(first, experiments=names)
    where = ", ".join(_IN_JOINT.sub(r" (joint \1)", place) for place in places)
    pieces = _NUMBER.split(_without_place(first))
    numbers = zip(*(_NUMBER.findall(_without_place(each)) for each in group), strict=True)
    message = pieces[0]
    for values, piece in zip(numbers, pieces[1:], strict=True):
        smallest, largest = min(values, key=float), max(values, key=float)
        message += (smallest if smallest == largest else f"{smallest} to {largest}") + piece
    return replace(first, where=where, message=message, experiments=names)


def _current_warnings(found: Identification, decisions: Sequence[Decision]) -> Iterator[Diagnostic]:
    """Yield all warnings except those about parameters that a later stage decides."""
    final = {_place_name(d.parameter): d for d in decisions}
    tuned_warnings = set(found.tuned.warnings) if found.tuned is not None else set()
    for warning in found.warnings:
        decision = final.get(warning.where)
        if warning.code in _STAGE_CODES and warning not in tuned_warnings:
            if decision is None:  # the whole-arm fit has a stiffness curve instead
                is_superseded = found.tuned is not None and warning.where.startswith(
                    "gear_stiffness "
                )
            else:
                has_value = decision.parameter.value is not None
                is_superseded = decision.parameter.stage == "tuned"
                is_superseded = is_superseded or (warning.code == "not-identifiable" and has_value)
            if is_superseded:
                continue
        yield warning


def _place_name(p: Parameter) -> str:
    """Name of a parameter in warnings."""
    return p.name if p.joint is None else f"{p.name} of joint {p.joint}"
