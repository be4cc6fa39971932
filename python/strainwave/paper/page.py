"""comparisons.json -> Markdown: the tables of docs/comparisons.md."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

from strainwave.domain import OUTCOMES, outcomes_text

Claim = Mapping[str, Any]

_PROTOCOLS = {
    "own": "the program's own settings",
    "as-published": "the source's settings",
}
_REASONS = 3  # of one claim that the page gives at most; comparisons.json has them all


def to_markdown(document: Mapping[str, Any]) -> str:
    """The results of a run of `strainwave demo` as a page in Markdown.

    `document`: From `document_of`, or read from comparisons.json. Returns: What was done, a table
    of verdicts, then the criteria of every claim; ends with a newline.
    """
    claims: Sequence[Claim] = document["claims"]
    protocols = [name for name in _PROTOCOLS if any(c["protocol"] == name for c in claims)]
    figures = list(dict.fromkeys(c["figure"] for c in claims))
    by = {(c["figure"], c["protocol"]): c for c in claims}
    lines = [
        files("strainwave.paper").joinpath("introduction.md").read_text("utf-8"),
        "## Verdicts",
        "",
        f"Version {document['version']}, seeds {_seeds(document['seeds'])}.",
        "",
        "| figure | claim | " + " | ".join(_PROTOCOLS[name] for name in protocols) + " |",
        "|---" * (2 + len(protocols)) + "|",
    ]
    for figure in figures:
        own = [by[figure, name] for name in protocols if (figure, name) in by]
        cells = [_verdict(by.get((figure, name))) for name in protocols]
        lines.append(f"| {figure} | {_cell(own[0]['claim'])} | {' | '.join(cells)} |")
    for figure in figures:
        own = [by[figure, name] for name in protocols if (figure, name) in by]
        lines += ["", f"## Fig. {figure}: {own[0]['title']}", "", own[0]["claim"], ""]
        for claim in own:
            lines += _section(claim)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip() + "\n"


def _section(claim: Claim) -> Iterator[str]:
    count = len(claim["outcomes"])
    yield f"**By {_PROTOCOLS[claim['protocol']]}: {_verdict(claim)}.** {claim['messages'][0]}."
    yield ""
    if claim["criteria"]:
        yield "| criterion | least | median | largest | limit, and why | kept in |"
        yield "|---|---|---|---|---|---|"
        for c in claim["criteria"]:
            numbers = " | ".join(_spread(c["values"]))
            limit = f"{c['bound']} {c['limit']:g}: {c['reason']}"
            kept = f"{sum(c['passed'])}/{count}"
            yield f"| {_cell(c['name'])} | {numbers} | {_cell(limit)} | {kept} |"
        yield ""
    for said in _reasons(claim):
        yield f"- {said}"
    yield from _models(claim)
    yield ""


def _reasons(claim: Claim) -> Iterator[str]:
    """Why the claim was not shown or did not hold, one seed's words for each."""
    seen: dict[str, list[str]] = {}
    for outcome, reasons in zip(claim["outcomes"], claim["reasons"], strict=True):
        for reason in reasons:
            # numbers differ from seed to seed; what the number is of does not
            subject = re.sub(
                r" (-?[\d.]+(e[-+]?\d+)?|none), expected .*", "", reason.split(": ")[0]
            )
            key = f"{OUTCOMES[outcome]}|{subject}"
            seen.setdefault(key, []).append(reason)
    ordered = sorted(seen.items(), key=lambda item: -len(item[1]))
    for key, found in ordered[:_REASONS]:
        yield f"{key.split('|')[0]} in {len(found)}: {found[0]}"
    if len(ordered) > _REASONS:
        yield f"and {len(ordered) - _REASONS} other reasons"


def _models(claim: Claim) -> Iterator[str]:
    """How many of the models behind the claim are sound, over all seeds."""
    every = [
        dict(zip(("status", "growth", "sound", "decisive"), values, strict=True))
        for m in claim["models"]
        for values in zip(m["status"], m["growth"], m["sound"], m["decisive"], strict=True)
        if values[0] is not None
    ]
    if not every:
        return
    states = Counter(
        "unstable" if (m["growth"] or 0.0) > 1.0 else m["status"] for m in every if m["decisive"]
    )
    listed = ", ".join(f"{number} {name}" for name, number in states.most_common())
    yield f"- models that the claim rests on: {listed}"
    beside = [m for m in every if not m["decisive"]]
    if beside:
        unsound = sum(not m["sound"] for m in beside)
        yield f"- models shown beside: {len(beside)}, of which {unsound} are not sound"


def _verdict(claim: Claim | None) -> str:
    if claim is None:
        return ""
    return outcomes_text(claim["outcomes"])


def _spread(values: Sequence[float | None]) -> tuple[str, str, str]:
    known = sorted(value for value in values if value is not None)
    if not known:
        return ("none",) * 3
    middle = known[len(known) // 2]
    if len(known) % 2 == 0:
        middle = 0.5 * (middle + known[len(known) // 2 - 1])
    return f"{known[0]:.5g}", f"{middle:.5g}", f"{known[-1]:.5g}"


def _seeds(seeds: Sequence[int]) -> str:
    return str(seeds[0]) if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
