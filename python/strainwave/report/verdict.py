"""The verdict: how good, what to trust and what not, in plain words computed from the result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from strainwave.records import Identification, Parameter, Prediction
from strainwave.report.remedies import MILD, most_serious, place_of

_CLASSES = (
    (0.01, "Told to 1 % or better"),
    (0.1, "Told to 10 % or better"),
    (1.0, "Told roughly, worse than 10 %"),
    (math.inf, "Not to be told from zero"),
)
"""Half of the 95 % interval over the value, and what is said of it."""
_USEFUL = 0.1  # of these: up to which a parameter is good to simulate with
_WELL = 85.0  # [%] fit in the middle from which a model foretells well
_GRADES = ((95.0, "very well"), (_WELL, "well"), (60.0, "in part"), (-math.inf, "badly"))


def verdict(identification: Identification) -> str:
    """The first thing on the page.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    str
        HTML.
    """
    parameters = identification.parameters
    missing = [p for p in parameters if p.value is None]
    fits = _fits(identification.checks)
    grave = [w for w in identification.warnings if w.code not in MILD]
    good = not (missing or grave or (fits and _middle(fits) < _WELL))
    mark = "" if good else "doubt"
    lead = f"<strong>{_found(parameters)}</strong>"
    if identification.reason is not None:
        mark = "bad"
        lead = "<strong>Not everything could be told.</strong> " + escape(identification.reason)
    said = [lead, _on_new_data(identification.checks, fits), *_of_warnings(identification)]
    text = "".join(f"<p>{one}</p>" for one in said)
    return f'<div class="verdict {mark}">{text}{_trust(identification)}</div>'


def _trust(identification: Identification) -> str:
    """Parameters by how surely they are told."""
    groups: dict[str, list[Parameter]] = {name: [] for _, name in _CLASSES}
    groups |= {"Told without an interval": [], "Not told": []}
    for p in identification.parameters:
        groups[_class(p)].append(p)
    terms = [(name, named(found)) for name, found in groups.items() if found]
    together = [
        w.where.replace("_", " ") for w in identification.warnings if w.code == "only-together"
    ]
    if together:
        terms.append(("Told only in combination", "; ".join(together)))
    items = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in terms)
    return f"<dl>{items}</dl>" if items else ""


def _class(parameter: Parameter) -> str:
    if parameter.value is None:
        return "Not told"
    if parameter.ci95 is None:
        return "Told without an interval"
    half = 0.5 * (parameter.ci95[1] - parameter.ci95[0])
    relative = half / abs(parameter.value) if parameter.value else math.inf
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


def _found(parameters: Sequence[Parameter]) -> str:
    """How many have a value, and how many of these are good for something."""
    if not parameters:
        return "No parameter was found."
    told = sum(p.value is not None for p in parameters)
    sure = sum(
        _class(p) in (name for limit, name in _CLASSES if limit <= _USEFUL) for p in parameters
    )
    whole = f"All {told}" if told == len(parameters) else f"{told} of {len(parameters)}"
    return f"{whole} parameters have a value, {sure} of them to {100.0 * _USEFUL:.0f} % or better."


def _on_new_data(checks: Sequence[Prediction], fits: Sequence[tuple[float, str, str]]) -> str:
    """How well the records are foretold that were not fitted."""
    if not checks:
        return "No record was kept for checking: nothing says how the model does on new data."
    if not fits:
        return "The check records hardly move: nothing says how the model does on new data."
    worst, middle = min(fits), _middle(fits)
    grade = next(word for least, word in _GRADES if middle >= least)
    return (
        f"Records it never saw the model foretells {grade}: it explains at least {worst[0]:.1f} % "
        f"(fit of {escape(worst[2])} in “{escape(worst[1])}”), and {middle:.1f} % in the middle "
        f"of {_count(len(fits), 'channel')}."
    )


def _fits(checks: Sequence[Prediction]) -> list[tuple[float, str, str]]:
    """Fit, record and channel of all that moves."""
    return [
        (fit, prediction.experiment, channel)
        for prediction in checks
        for channel, fit in prediction.fit_percent.items()
        if math.isfinite(fit)
    ]


def _middle(fits: Sequence[tuple[float, str, str]]) -> float:
    return float(np.median([fit for fit, _, _ in fits]))


def _of_warnings(identification: Identification) -> list[str]:
    if not identification.warnings:
        return []
    worst = most_serious(identification.warnings)
    several = len(identification.warnings) > 1
    lead = "the most serious, of" if several else "of"
    return [
        f'<a href="#warnings">{_count(len(identification.warnings), "warning")}</a>; {lead} '
        f"{escape(place_of(worst))}: {escape(worst.message)}."
    ]


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
