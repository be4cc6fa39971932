"""Identification -> the warnings to publish: still true, one for each cause."""

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
"""A number of the case; not the joint's in "joint 2", nor a part of a name as in "u1"."""
_IN_JOINT = re.compile(r", joint (\d+)$")
_OF_ONE_STAGE = frozenset({"not-identifiable", "implausible", "equivalent-stiffness"})
"""Codes that speak of one parameter as one stage sees it."""


def published_warnings(found: Identification) -> tuple[Diagnostic, ...]:
    """The warnings of a run, without those a later stage has overtaken, one per cause.

    What a stage says of a parameter that another one decides is left out; it still stands in the
    stage's own list. A value that was rejected has a warning with its reason.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    tuple of Diagnostic
    """
    decisions = found.decisions
    kept = [*_still_true(found, decisions), *rejections(decisions)]
    kept += model_defects(found)
    for size in implausible_joints(found.study.arm, found.parameters):
        kept.append(Diagnostic("implausible-size", f"joint {size.joint}", size.text))
    unpredicted = any(check.unexplained for check in found.checks)
    if found.tuned is not None and not found.verdict.validated.elastic and not unpredicted:
        where = str(found.study.path)
        kept.append(Diagnostic("elastic-not-validated", where, not_exercised(found)))
    experiments = [e.name for e in found.study.experiments]
    return grouped(dict.fromkeys(kept), experiments)


def rejections(decisions: Iterable[Decision]) -> Iterator[Diagnostic]:
    """A warning for each reason to reject values, with the values.

    Parameters
    ----------
    decisions : iterable of Decision

    Yields
    ------
    Diagnostic
    """
    by_reason: dict[str, list[Decision]] = {}
    for one in decisions:
        if one.rejected:
            by_reason.setdefault(one.rejected, []).append(one)
    for why, rows in by_reason.items():
        values = ", ".join(f"{d.parameter.label} = {d.raw:.4g}" for d in rows if d.raw is not None)
        numbers = {d.parameter.joint for d in rows}
        joints = ", ".join(str(n) for n in sorted(n for n in numbers if n is not None))
        where = f"joint {joints}" if joints and None not in numbers else "arm"
        if len(rows) == 1:
            where = _place(rows[0].parameter)
        yield Diagnostic("rejected", where, f"{why}; what it gave does not count: {values}")


def not_exercised(found: Identification) -> str:
    """Why validation says nothing of the elastic model, and what to record.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    str
        A clause without a full stop.
    """
    moving = [check for check in found.checks if not check.of_drive]
    record = (
        'record steps under the servo, or a PRBS, as use = "check", with the angle and the voltage '
        "of every motor and the servo's references"
    )
    if found.tuned is None:
        return "there is no whole-arm fit to predict with"
    if not moving:
        return f"no check record can be simulated; {record}"
    missed = ", ".join(check.experiment for check in moving if check.unexplained)
    if missed:
        return f"the whole-arm fit does not predict {missed}"
    names = ", ".join(dict.fromkeys(check.experiment for check in moving))
    return f"{names} would be predicted alike with other gear stiffness; {record}"


def grouped(warnings: Iterable[Diagnostic], experiments: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Warnings of one cause in several records as one that lists them.

    Causes are one where code and message are, but for numbers; where those differ the message has
    their range. A place is a record, or a joint in one as in "prbs-j1, joint 1".

    Parameters
    ----------
    warnings : iterable of Diagnostic
    experiments : sequence of str
        The records' names: only warnings about records are grouped.

    Returns
    -------
    tuple of Diagnostic
        Each where the first of its kind stood.
    """
    alike: dict[tuple[str, ...], list[Diagnostic]] = {}
    for each in warnings:
        cause = (
            (each.code, _NUMBER.sub("#", _without_place(each)))
            if _record(each) in experiments
            else (each.code, each.where, each.message)
        )
        alike.setdefault(cause, []).append(each)
    return tuple(_one(group, experiments) for group in alike.values())


def _record(warning: Diagnostic) -> str:
    return _IN_JOINT.sub("", warning.where)


def _without_place(warning: Diagnostic) -> str:
    return warning.message.replace(_record(warning), "")


def _one(group: Sequence[Diagnostic], experiments: Sequence[str]) -> Diagnostic:
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
    for found, piece in zip(numbers, pieces[1:], strict=True):
        least, most = min(found, key=float), max(found, key=float)
        message += (least if least == most else f"{least} to {most}") + piece
    return replace(first, where=where, message=message, experiments=names)


def _still_true(found: Identification, decisions: Sequence[Decision]) -> Iterator[Diagnostic]:
    """Without what an earlier stage says of a parameter that a later one decides."""
    final = {_place(d.parameter): d for d in decisions}
    own = set(found.tuned.warnings) if found.tuned is not None else set()
    for warning in found.warnings:
        decision = final.get(warning.where)
        if warning.code in _OF_ONE_STAGE and warning not in own:
            if decision is None:  # one stiffness, where the whole-arm fit has a curve
                overtaken = found.tuned is not None and warning.where.startswith("gear_stiffness ")
            else:
                known = decision.parameter.value is not None
                overtaken = decision.parameter.stage == "tuned"
                overtaken = overtaken or (warning.code == "not-identifiable" and known)
            if overtaken:
                continue
        yield warning


def _place(p: Parameter) -> str:
    """As warnings name a parameter."""
    return p.name if p.joint is None else f"{p.name} of joint {p.joint}"
