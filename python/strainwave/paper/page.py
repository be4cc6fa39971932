"""Markdown page of a run of `strainwave demo`, docs/comparisons.md, from comparisons.json."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from strainwave.domain import OUTCOME_TEXTS, Protocol, outcomes_text
from strainwave.io.templates import fill_text
from strainwave.presentation.report.comparisons import PROTOCOL_TEXTS

Claim = Mapping[str, Any]
ByProtocol = dict[str, Any]


def to_markdown(document: Mapping[str, Any]) -> str:
    """The page of a run of `strainwave demo`: verdicts, then the criteria of every figure.

    `document` comes from `document_of` or from comparisons.json.
    """
    claims: Sequence[Claim] = document["claims"]
    figures: dict[int, ByProtocol] = {}
    limits: dict[str, dict[str, None]] = {}  # reason -> limits
    for claim in claims:
        figures.setdefault(claim["figure"], {})[claim["protocol"]] = claim
        for criterion in claim["criteria"]:
            limits.setdefault(criterion["reason"], {})[_limit(criterion)] = None
    seeds = document["seeds"]
    return fill_text(
        Path(__file__).with_name("page.md.j2"),
        version=document["version"],
        arm=document["arm"],
        images=document["images"],
        loads=_loads(figures.get(2, {})),
        seeds=seeds[0] if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}",
        settings={
            name: text
            for name, text in PROTOCOL_TEXTS.items()
            if any(claim["protocol"] == name for claim in claims)
        },
        figures=figures,
        limits=limits,
        cell=lambda text: text.replace("|", "\\|"),
        criteria_of=_criteria_of,
        outcomes_text=outcomes_text,
        reasons_of=_reasons_of,
        spread_of=_spread_of,
    )


def _loads(stiffest: Mapping[str, Claim]) -> str:
    """Loads of both gears at the largest amplitude, over their last knees, from Fig. 2."""
    claim = next(iter(stiffest.values()), None)
    loads = [] if claim is None else [claim["values"][f"gear_load_{joint}"][0] for joint in (1, 2)]
    return " and ".join(f"{load:.2g}" for load in loads)


def _limit(criterion: Mapping[str, Any]) -> str:
    return f"{criterion['bound']} {criterion['limit']:g}"


def _criteria_of(by_protocol: Mapping[str, Claim]) -> dict[tuple[str, str], ByProtocol]:
    """Criteria of a figure by name and limit, then by protocol."""
    criteria: dict[tuple[str, str], ByProtocol] = {}
    for protocol, claim in by_protocol.items():
        for criterion in claim["criteria"]:
            key = criterion["name"], _limit(criterion)
            criteria.setdefault(key, {})[protocol] = criterion
    return criteria


def _spread_of(criterion: Mapping[str, Any]) -> str:
    """Median and range of the values, and how many pass."""
    values = [value for value in criterion["values"] if value is not None]
    spread = "none"
    if values:
        least, middle, largest = (f"{f(values):.4g}" for f in (min, median, max))
        spread = middle if least == largest else f"{middle} ({least} to {largest})"
    return f"{spread}, {sum(criterion['passed'])}/{len(criterion['passed'])}"


def _reasons_of(by_protocol: Mapping[Protocol, Claim]) -> list[str]:
    """For each protocol the most frequent reason why a claim is not shown, with one example."""
    reasons = []
    for protocol, claim in by_protocol.items():
        examples: dict[tuple[str, str], dict[int, str]] = {}
        outcomes = zip(claim["outcomes"], claim["reasons"], strict=True)
        for seed, (outcome, texts) in enumerate(outcomes):
            for text in texts:
                # numbers and joints differ between seeds and criteria, the explanation does not
                explanation = re.search(r"\((.*)\)$", text)
                kind = re.sub(r"[-+\d.]+", "", explanation[1] if explanation else text)
                examples.setdefault((OUTCOME_TEXTS[outcome], kind), {}).setdefault(seed, text)
        if examples:
            (outcome, _), by_seed = max(examples.items(), key=lambda item: len(item[1]))
            example = next(iter(by_seed.values()))
            reasons.append(f"{PROTOCOL_TEXTS[protocol]}, {outcome} in {len(by_seed)}: {example}")
    return reasons
