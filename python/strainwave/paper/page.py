"""Markdown page of a run of `strainwave demo`, docs/comparisons.md, from comparisons.json."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

from strainwave.domain import OUTCOME_TEXTS, outcomes_text

Claim = Mapping[str, Any]

_PROTOCOLS = {
    "own": "default settings",
    "as-published": "published settings",
}
_MAX_REASONS = 1  # per claim on the page; comparisons.json has them all


def to_markdown(document: Mapping[str, Any]) -> str:
    """The page of a run of `strainwave demo`: verdicts, then the criteria of every figure.

    `document` comes from `document_of` or from comparisons.json.
    """
    claims: Sequence[Claim] = document["claims"]
    protocols = [name for name in _PROTOCOLS if any(c["protocol"] == name for c in claims)]
    figures: dict[int, dict[str, Claim]] = {}
    for claim in claims:
        figures.setdefault(claim["figure"], {})[claim["protocol"]] = claim
    lines = [
        files("strainwave.paper").joinpath("introduction.md").read_text("utf-8"),
        "## Verdicts",
        "",
        f"Version {document['version']}, seeds {_seeds(document['seeds'])}.",
        "",
        "| figure | claim | " + " | ".join(_PROTOCOLS[name] for name in protocols) + " |",
        "|---" * (2 + len(protocols)) + "|",
    ]
    for figure, by_protocol in figures.items():
        cells = [_verdict(by_protocol.get(name)) for name in protocols]
        claim_text = _cell(next(iter(by_protocol.values()))["claim"])
        lines.append(f"| {figure} | {claim_text} | {' | '.join(cells)} |")
    lines += ["", "## Limits", "", "| limit | reason |", "|---|---|"]
    limits = {(c["name"], _limit(c)): c["reason"] for claim in claims for c in claim["criteria"]}
    for reason in dict.fromkeys(limits.values()):
        of_reason = dict.fromkeys(limit for (_, limit), text in limits.items() if text == reason)
        lines.append(f"| {', '.join(of_reason)} | {_cell(reason)} |")
    for figure, by_protocol in figures.items():
        lines += ["", f"## Fig. {figure}: {next(iter(by_protocol.values()))['title']}", ""]
        lines += _criteria(by_protocol, protocols)
        for name in protocols:
            lines += _reasons(by_protocol[name]) if name in by_protocol else ()
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip() + "\n"


def _criteria(by_protocol: Mapping[str, Claim], protocols: Sequence[str]) -> Iterator[str]:
    """Table of a figure's criteria: median and range of the values, and how many pass."""
    yield "| criterion | limit | " + " | ".join(_PROTOCOLS[name] for name in protocols) + " |"
    yield "|---" * (2 + len(protocols)) + "|"
    columns = {
        protocol: {(c["name"], _limit(c)): c for c in claim["criteria"]}
        for protocol, claim in by_protocol.items()
    }
    for key in dict.fromkeys(key for column in columns.values() for key in column):
        cells = [_passed(columns.get(name, {}).get(key)) for name in protocols]
        yield f"| {_cell(key[0])} | {key[1]} | {' | '.join(cells)} |"
    yield ""


def _passed(criterion: Mapping[str, Any] | None) -> str:
    if criterion is None:
        return ""
    least, median, largest = _spread_cells(criterion["values"])
    spread = median if least == largest else f"{median} ({least} to {largest})"
    return f"{spread}, {sum(criterion['passed'])}/{len(criterion['passed'])}"


def _limit(criterion: Mapping[str, Any]) -> str:
    return f"{criterion['bound']} {criterion['limit']:g}"


def _reasons(claim: Claim) -> Iterator[str]:
    """The most frequent reasons why a claim is not shown or does not hold, one example of each."""
    examples: dict[tuple[str, str], dict[int, str]] = {}
    for seed, (outcome, reasons) in enumerate(
        zip(claim["outcomes"], claim["reasons"], strict=True)
    ):
        for reason in reasons:
            # numbers and joints differ between seeds and criteria, the explanation does not
            explanation = re.search(r"\((.*)\)$", reason)
            kind = re.sub(r"[-+\d.]+", "", explanation[1] if explanation else reason)
            examples.setdefault((OUTCOME_TEXTS[outcome], kind), {}).setdefault(seed, reason)
    most_frequent = sorted(examples.items(), key=lambda item: -len(item[1]))[:_MAX_REASONS]
    for (outcome, _), by_seed in most_frequent:
        example = next(iter(by_seed.values()))
        yield f"- {_PROTOCOLS[claim['protocol']]}, {outcome} in {len(by_seed)}: {example}"


def _verdict(claim: Claim | None) -> str:
    if claim is None:
        return ""
    return outcomes_text(claim["outcomes"])


def _spread_cells(values: Sequence[float | None]) -> tuple[str, ...]:
    """Least, median and largest value as text."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return ("none",) * 3
    middle = known[len(known) // 2]
    if len(known) % 2 == 0:
        middle = 0.5 * (middle + known[len(known) // 2 - 1])
    return f"{known[0]:.4g}", f"{middle:.4g}", f"{known[-1]:.4g}"


def _seeds(seeds: Sequence[int]) -> str:
    return str(seeds[0]) if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
