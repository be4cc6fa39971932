"""Verdict: identified and unidentified parameters, fits of check records, and warnings.

Each warning has the meaning and the remedy of its code; the most serious come first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from strainwave.domain import (
    Decision,
    Diagnostic,
    Identification,
    Parameter,
    Prediction,
    half_width,
)
from strainwave.domain.arm.effects import possible_causes
from strainwave.domain.keys import Key
from strainwave.domain.messages import catalogue, short_place
from strainwave.domain.results.identification import missing_validation
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Block, Callout, Cell, Facts, Mark, Row, Span

TROUBLESHOOTING_PAGE = "docs/troubleshooting.md"
"""The page with a section for each code."""


class Advice(NamedTuple):
    """Meaning of a warning for the result, and remedy."""

    meaning: str
    remedy: str


def advice() -> Mapping[str, Advice]:
    """Meaning and remedy by code, the most serious first."""
    advice = {
        code: Advice(_plain(entry["meaning"]), _plain(entry["remedy"]))
        for code, entry in catalogue().items()
    }
    effects = {
        effect.warning_code: Advice(f"Without this effect, {effect.consequence}.", effect.remedy)
        for effect in possible_causes()
    }
    of_result = [c for c, entry in catalogue().items() if entry["severity"] == "result"]
    return {code: advice[code] for code in of_result} | effects | advice


def is_note(code: str) -> bool:
    """Whether a warning requires no action."""
    entry = catalogue().get(code, {})
    return bool(entry.get("is_note", entry.get("severity") == "scope"))


def _plain(markdown: str) -> str:
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown).replace("`", "")


def by_severity(warnings: Iterable[Diagnostic]) -> list[Diagnostic]:
    """The most serious first; of equal severity in their order."""
    codes = list(advice())
    return sorted(warnings, key=lambda warning: codes.index(warning.code))


def warnings_table(warnings: Iterable[Diagnostic]) -> Iterator[Block]:
    """Observation, meaning and remedy of every warning, the most serious first."""
    codes = advice()
    rows = [
        (
            blocks.prose(short_place(w.places)),
            blocks.prose(sentence(w.message)),
            blocks.prose(codes[w.code].meaning),
            blocks.prose(codes[w.code].remedy),
            Cell(w.code, "code"),
        )
        for w in by_severity(warnings)
    ]
    heads = ("where", "observed", "meaning", "what to do", "code")
    yield from blocks.table("Warnings", heads, rows, heading=False)
    if rows:
        yield blocks.paragraph(
            "Each code has a section in ", Span(TROUBLESHOOTING_PAGE, kind="code"), "."
        )


def sentence(text: str) -> str:
    """Text with a capital letter and a full stop; a name at the beginning stays as it is."""
    first = text.split(" ", 1)[0]
    is_word = first.isalpha() and first.islower()
    text = text[:1].upper() + text[1:] if is_word else text
    return text if text.endswith((".", "?", "!")) else f"{text}."


_CLASSES = (
    (0.01, "95 % half-width up to 1 %"),
    (0.1, "95 % half-width up to 10 %"),
    (1.0, "95 % half-width above 10 %"),
    (math.inf, "Zero within 2 % of the joint torque"),
)
"""Classes of identified parameters by the half-width of the 95 % interval over the value."""
_UNCERTAIN = "Not identified: the 95 % interval is wider than the value"
_NO_VALUE = "Not identified"
_REJECTED = "Rejected: reasons under Parameters"
_CONTRADICTED = "Rejected: do not use"  # values that depend on a fault of the input
_USABLE_HALF_WIDTH = 0.1  # relative: good enough to simulate with
_TITLES: Mapping[str, tuple[str, Mark]] = {
    "determined": ("Determined", "good"),
    "partly-determined": ("Partly determined", "doubt"),
    "not-determined": ("Not determined", "bad"),
    "inconsistent-input": ("Inconsistent input", "bad"),
}
Fit = tuple[float, str, str]
"""Fit [%], channel and record."""


def verdict(identification: Identification) -> Callout:
    """The summary at the top of the page."""
    result = identification.verdict
    title, mark = _TITLES[result.status]
    reasons = () if result.suspected else result.reasons
    heads = ("channel or key", "observed", "correction")
    faults: list[Row] = [
        (suspicion.where, blocks.prose(sentence(suspicion.message)), blocks.prose(suspicion.remedy))
        for suspicion in result.suspected
    ]
    content: list[Block] = [
        blocks.paragraph(
            Span(title, kind="badge", mark=mark), f" {_count_identified(identification.decisions)}"
        ),
        *(blocks.paragraph(sentence(reason)) for reason in reasons),
        *([blocks.paragraph(note)] if (note := scale_note(identification)) else []),
        *blocks.table("Faults of the input", heads, faults, heading=False),
        *_validation_blocks(identification),
    ]
    warnings = by_severity(identification.warnings)
    if warnings:
        count, worst = len(warnings), warnings[0]
        link = Span("1 warning" if count == 1 else f"{count} warnings", href="#warnings")
        lead = "; most serious: " if count > 1 else ": "
        place, text = short_place(worst.places), sentence(worst.message)
        content.append(blocks.paragraph(link, f"{lead}{place}: {text}"))
    groups = tuple(_certainty_groups(identification))
    if groups:
        content.append(Facts(groups))
    return Callout(mark, tuple(content))


def scale_note(identification: Identification) -> str:
    """The constants with which all torques scale; empty if the records determine the scale."""
    study = identification.study
    has_load = any(experiment.payload for experiment in study.experiments)
    if identification.drive_gains or has_load or not identification.verdict.identified:
        return ""
    has_voltages = any(joint.torque_per_volt is not None for joint in study.arm.joints)
    constant = "torque_per_volt" if has_voltages else "the scale of the torque channels"
    if study.arm.position_servo is not None:
        constant = "the gain kp of the position servos"
    return (
        f"Inertias, friction, gravity and stiffness scale with {constant}; an error that all joints"
        " share is not visible in the records."
    )


def _certainty_groups(identification: Identification) -> Iterator[tuple[str, str]]:
    decisions = identification.decisions
    groups: dict[str, list[Parameter]] = {name: [] for _, name in _CLASSES}
    groups |= {_UNCERTAIN: [], _NO_VALUE: [], _REJECTED: []}
    for decision in decisions:
        groups[_certainty_class(decision)].append(decision.parameter)
    if identification.suspected:
        groups[_CONTRADICTED] = groups.pop(_REJECTED)
    for name, members in groups.items():
        if members:
            yield name, named(p.key for p in members)
    estimated = {d.parameter.key for d in decisions}
    missing = [key for key in identification.verdict.not_identified if key not in estimated]
    if missing:
        yield "Not estimated", named(missing)
    pairs = [
        w.where.replace("_", " ") for w in identification.warnings if w.code == "only-together"
    ]
    if pairs:
        yield "Only the combination is identified", "; ".join(pairs)


def _certainty_class(decision: Decision) -> str:
    p = decision.parameter
    if p.value is None:
        return _REJECTED if decision.rejected else _NO_VALUE
    half = half_width(p)
    if not decision.identified or half is None:
        return _UNCERTAIN
    relative = half / abs(p.value) if p.value else math.inf
    return next(name for limit, name in _CLASSES if relative <= limit)


def named(parameters: Iterable[Key]) -> str:
    """Names with their joints: `gear stiffness (1, 2), alpha`."""
    joints: dict[str, list[str]] = {}
    for name, joint in parameters:
        numbers = joints.setdefault(name.replace("_", " "), [])
        if joint is not None:
            numbers.append(str(joint))
    return ", ".join(
        f"{name} ({', '.join(sorted(numbers))})" if numbers else name
        for name, numbers in joints.items()
    )


def _count_identified(decisions: Sequence[Decision]) -> str:
    if not decisions:
        return "No parameter was estimated."
    usable = {name for limit, name in _CLASSES if limit <= _USABLE_HALF_WIDTH}
    accurate = sum(_certainty_class(d) in usable for d in decisions)
    identified = sum(d.identified for d in decisions)
    noun = "parameter is" if len(decisions) == 1 else "parameters are"
    share = "All" if identified == len(decisions) > 1 else f"{identified} of"
    return (
        f"{share} {len(decisions)} {noun} identified,"
        f" {accurate} with a 95 % half-width of {100.0 * _USABLE_HALF_WIDTH:.0f} % or less."
    )


def _validation_blocks(identification: Identification) -> Iterator[Block]:
    names = [e.name for e in identification.study.experiments if e.use == "check"]
    if not identification.checks:
        reason = "the input is inconsistent"
        if not identification.suspected:
            reason = "no model was estimated"
        noun = "check record was" if len(names) == 1 else "check records were"
        text = f"{len(names)} {noun} not predicted because {reason}: {', '.join(names)}."
        if not names:
            text = 'the study has no check record. Record one with use = "check".'
        yield blocks.paragraph(Span("Not validated: ", strong=True), text)
        return
    fits, validated = check_fits(identification), identification.verdict.validated.elastic
    rows = [_fit_row(MODELS[name][0], fits[name]) for name in ("rigid", "servo") if fits[name]]
    is_missed = any(check.unexplained for check in identification.checks if not check.of_drive)
    if fits["elastic"] and (validated or is_missed):
        rows.append(_fit_row(MODELS["elastic"][0], fits["elastic"]))
    numbers = map(blocks.number, ("channels", "median fit", "lowest fit"))
    heads: Row = ("check records predicted by", *numbers, "lowest in")
    yield from blocks.table("Fits of check records", heads, rows, heading=False)
    if note := drive_note(identification):
        yield blocks.paragraph(note)
    if any(joint.elastic for joint in identification.study.arm.joints) and not validated:
        lead = Span("Elastic model not validated: ", strong=True)
        yield blocks.paragraph(lead, f"{missing_validation(identification).message}.")
    elif not rows:
        lead = Span("Not validated: ", strong=True)
        yield blocks.paragraph(lead, "the motors almost do not move in the check records.")


def drive_note(identification: Identification) -> str:
    """What limits the fits of the rigid model on an elastic arm, if check records have any."""
    drives = dict.fromkeys(
        channel for check in identification.checks if check.of_drive for channel in check.channels
    )
    if not drives or not any(joint.elastic for joint in identification.study.arm.joints):
        return ""
    return (
        f"The rigid model, which predicts {', '.join(drives)}, has no vibration of gears: its fits"
        " fall with the speed of the record and do not count against the result."
    )


def _fit_row(model: str, fits: Sequence[Fit]) -> Row:
    lowest, channel, record = min(fits)
    median = np.median([fit for fit, _, _ in fits])
    numbers = (str(len(fits)), f"{median:.1f} %", f"{lowest:.1f} %")
    return (model, *map(blocks.number, numbers), f"{channel} in {record}")


MODELS = {
    "rigid": ("rigid model, drive", "drive by the rigid model"),
    "elastic": ("elastic model, motion", "motion by the elastic model"),
    "servo": ("servo loop, angles", "angles by the simulated servo loop"),
}
"""Models that predict records: their names in tables and in titles of figures."""


def predicting_model(identification: Identification, prediction: Prediction) -> str:
    """The model that predicts a record, a key of `MODELS`."""
    if prediction.of_drive:
        return "rigid"
    return "elastic" if identification.study.arm.position_servo is None else "servo"


def check_fits(identification: Identification) -> dict[str, list[Fit]]:
    """Fits of the check channels that move, by model."""
    fits: dict[str, list[Fit]] = {name: [] for name in MODELS}
    for prediction in identification.checks:
        fits[predicting_model(identification, prediction)] += [
            (fit, channel, prediction.experiment)
            for channel, fit in prediction.fit_percent.items()
            if math.isfinite(fit)
        ]
    return fits
