"""The verdict: how good, what to trust and what not, in plain words computed from the result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from strainwave.records import Identification, Parameter, Prediction
from strainwave.report.remedies import most_serious, place_of

_CLASSES = (
    (0.01, "Told to 1 % or better"),
    (0.1, "Told to 10 % or better"),
    (1.0, "Told roughly, worse than 10 %"),
    (math.inf, "Not to be told from zero"),
)
"""Half of the 95 % interval over the value, and what is said of it."""


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
    if identification.reason is not None:
        mark, lead = "bad", "<strong>Not everything could be told.</strong> "
        lead += escape(identification.reason)
    elif missing:
        mark = "doubt"
        told = len(parameters) - len(missing)
        lead = f"<strong>{told} of {len(parameters)} parameters are told by the data.</strong>"
    else:
        mark = "doubt" if identification.warnings else ""
        lead = f"<strong>All {len(parameters)} parameters are told by the data.</strong>"
    said = [lead, *_on_new_data(identification.checks), *_of_warnings(identification)]
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


def _on_new_data(checks: Sequence[Prediction]) -> list[str]:
    """How well the records are foretold that were not fitted."""
    if not checks:
        return [
            "No record was kept for checking: nothing here says how the model does on new data."
        ]
    fits = [
        (fit, prediction.experiment, channel)
        for prediction in checks
        for channel, fit in prediction.fit_percent.items()
        if math.isfinite(fit)
    ]
    if not fits:
        return ["The check records hardly move: nothing here says how the model does on new data."]
    worst = min(fits)
    middle = float(np.median([fit for fit, _, _ in fits]))
    return [
        f"On records it never saw the model explains at least {worst[0]:.1f} % "
        f"(fit of {escape(worst[2])} in “{escape(worst[1])}”), and {middle:.1f} % in the middle "
        f"of {_count(len(fits), 'channel')}."
    ]


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
