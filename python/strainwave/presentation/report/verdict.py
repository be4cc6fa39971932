"""The verdict in words: what is identified, what is not, and how validation data are predicted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from strainwave.domain import Decision, Identification, Parameter, Verdict, half_width
from strainwave.domain.diagnostics import not_exercised
from strainwave.presentation.report.blocks import (
    Block,
    Callout,
    Facts,
    Mark,
    Paragraph,
    Span,
    paragraph,
)
from strainwave.presentation.report.remedies import MILD, most_serious, place_of

_CLASSES = (
    (0.01, "95 % half-width 1 % or better"),
    (0.1, "95 % half-width 10 % or better"),
    (1.0, "95 % half-width worse than 10 %"),
    (math.inf, "Zero within 2 % of the joint torque"),
)
"""Of identified parameters: half of the 95 % interval over the value, and what is said of it."""
_UNCERTAIN = "Not identified: the 95 % interval is wider than the value"
_EMPTY = "Not identified"
_REJECTED = "Rejected: do not use"
_USEFUL = 0.1  # of the half-width: up to which a parameter is good to simulate with
_WELL = 85.0  # [%] median fit from which a model predicts well
_GRADES = ((95.0, "very well"), (_WELL, "well"), (60.0, "in part"), (-math.inf, "badly"))
_LEADS = {
    "determined": "Determined.",
    "partly-determined": "Partly determined.",
    "not-determined": "Not determined.",
    "inconsistent-input": "The input contradicts itself.",
}


def verdict(identification: Identification) -> Callout:
    """The first thing on the page.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    Callout
    """
    found = identification.verdict
    decisions = identification.decisions
    grave = [w for w in identification.warnings if w.code not in MILD]
    weak = any(fits and _median(fits) < _WELL for fits in _fits(identification).values())
    doubtful = grave or weak or found.not_identified or found.rejected
    mark: Mark = "doubt" if doubtful else ""
    if found.status != "determined":
        mark = "bad"
    why = "; ".join(found.reasons)
    rest = f" {why}. " if why else " "
    blocks: list[Block] = [
        paragraph(Span(_LEADS[found.status], strong=True), rest + _counted(decisions)),
        *_suspicions(found),
        *_on_new_data(identification),
        *_of_warnings(identification),
    ]
    groups = tuple(_groups(identification, decisions))
    if groups:
        blocks.append(Facts(groups))
    return Callout(mark, tuple(blocks))


def _suspicions(found: Verdict) -> Iterator[Paragraph]:
    """What is wrong with the input, and the line that would mend it."""
    for one in found.suspected:
        yield paragraph(Span(one.where, strong=True), f": {one.message} {one.remedy}")


def _groups(
    identification: Identification, decisions: Sequence[Decision]
) -> Iterator[tuple[str, str]]:
    """Parameters by how certain they are; those that do not count last."""
    groups: dict[str, list[Parameter]] = {name: [] for _, name in _CLASSES}
    groups |= {_UNCERTAIN: [], _EMPTY: [], _REJECTED: []}
    for decision in decisions:
        groups[_class(decision)].append(decision.parameter)
    yield from ((name, named(found)) for name, found in groups.items() if found)
    known = {d.parameter.label for d in decisions}
    absent = [name for name in identification.verdict.not_identified if name not in known]
    if absent:
        yield "Not reached", ", ".join(name.replace("_", " ") for name in absent)
    together = [
        w.where.replace("_", " ") for w in identification.warnings if w.code == "only-together"
    ]
    if together:
        yield "Only the combination is identified", "; ".join(together)


def _class(decision: Decision) -> str:
    p = decision.parameter
    if p.value is None:
        return _REJECTED if decision.rejected else _EMPTY
    half = half_width(p)
    if not decision.identified or half is None:
        return _UNCERTAIN
    relative = half / abs(p.value) if p.value else math.inf
    return next(name for limit, name in _CLASSES if relative <= limit)


def named(parameters: Iterable[Parameter]) -> str:
    """Names with the joints they are of: `gear stiffness (1, 2), alpha`.

    Parameters
    ----------
    parameters : iterable of Parameter

    Returns
    -------
    str
    """
    joints: dict[str, list[str]] = {}
    for p in parameters:
        own = joints.setdefault(p.name.replace("_", " "), [])
        if p.joint is not None:
            own.append(str(p.joint))
    return ", ".join(
        f"{name} ({', '.join(numbers)})" if numbers else name for name, numbers in joints.items()
    )


def _counted(decisions: Sequence[Decision]) -> str:
    """How many parameters are identified, and how many of these well enough to simulate with."""
    if not decisions:
        return "No parameter was estimated."
    good = {name for limit, name in _CLASSES if limit <= _USEFUL}
    sure = sum(_class(d) in good for d in decisions)
    number = sum(d.identified for d in decisions)
    whole = f"All {number}" if number == len(decisions) else f"{number} of {len(decisions)}"
    verb = "is" if whole == "All 1" else "are"
    noun = "parameter" if len(decisions) == 1 else "parameters"
    return (
        f"{whole} {noun} {verb} identified, {sure} with a 95 % half-width of "
        f"{100.0 * _USEFUL:.0f} % or better."
    )


def _on_new_data(identification: Identification) -> Iterator[Paragraph]:
    """How well each model predicts validation data, and whether these exercise it at all."""
    if not identification.checks:
        said = "No record was kept for validation: nothing says how the model does on new data."
        yield paragraph(said)
        return
    fits, validated = _fits(identification), identification.verdict.validated
    if fits["rigid"]:
        yield _graded("The rigid model predicts the torques of validation data", fits["rigid"])
    elastic = any(joint.elastic for joint in identification.study.arm.joints)
    if elastic and validated.elastic:
        yield _graded("The elastic model predicts the motion of validation data", fits["elastic"])
    elif elastic:
        lead = Span("Elastic model not validated:", strong=True)
        yield paragraph(lead, f" {not_exercised(identification)}")
    elif not fits["rigid"]:
        said = "The validation data hardly move: nothing says how the model does on new data."
        yield paragraph(said)


def _graded(lead: str, fits: Sequence[tuple[float, str, str]]) -> Paragraph:
    worst, median = min(fits), _median(fits)
    grade = next(word for least, word in _GRADES if median >= least)
    return paragraph(
        f"{lead} {grade}: median fit {median:.1f} % of {_count(len(fits), 'channel')}, "
        f"least {worst[0]:.1f} % ({worst[2]} in “{worst[1]}”)."
    )


def _fits(identification: Identification) -> dict[str, list[tuple[float, str, str]]]:
    """Fit, record and channel of all that moves, by model."""
    found: dict[str, list[tuple[float, str, str]]] = {"rigid": [], "elastic": []}
    for prediction in identification.checks:
        own = found["rigid" if prediction.of_drive else "elastic"]
        own += [
            (fit, prediction.experiment, channel)
            for channel, fit in prediction.fit_percent.items()
            if math.isfinite(fit)
        ]
    return found


def _median(fits: Sequence[tuple[float, str, str]]) -> float:
    return float(np.median([fit for fit, _, _ in fits]))


def _of_warnings(identification: Identification) -> Iterator[Paragraph]:
    if not identification.warnings:
        return
    worst = most_serious(identification.warnings)
    several = len(identification.warnings) > 1
    lead = "the most serious, of" if several else "of"
    counted = Span(_count(len(identification.warnings), "warning"), href="#warnings")
    yield paragraph(counted, f"; {lead} {place_of(worst)}: {worst.message}.")


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
