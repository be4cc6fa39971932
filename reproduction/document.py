"""Claims over several seeds as comparisons.json, and its Markdown page docs/comparisons.md.

claims.toml lists the claims of the source and their criteria.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

from reproduction.page import PROTOCOL_TEXTS
from reproduction.records import (
    OUTCOME_TEXTS,
    Comparison,
    Criterion,
    Evidence,
    Protocol,
    Tally,
    outcomes_text,
)
from strainwave import __version__
from strainwave.errors import StrainwaveError
from strainwave.io.templates import fill_text
from strainwave.report.figures import Figure

SCHEMA = "strainwave/comparisons/3"


def document_of(
    tallies: Sequence[Tally], seeds: Sequence[int], arm: str = "soft", images: Sequence[int] = ()
) -> dict[str, Any]:
    """Claims, outcomes and numbers of every seed as JSON values, without plots.

    `seeds` has the order of each tally's runs, `arm` is the name of the built-in arm, `images` are
    the figures of which the page shows a plot. Numbers without a value are None.
    """
    return {
        "schema": SCHEMA,
        "version": __version__,
        "arm": arm,
        "seeds": list(seeds),
        "images": list(images),
        "claims": [_claim(tally) for tally in tallies],
    }


def to_json(document: Mapping[str, Any]) -> bytes:
    """A document as UTF-8 text that ends with a newline."""
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _claim(tally: Tally) -> dict[str, Any]:
    first = max(tally.runs, key=lambda run: len(run.criteria))  # a run that did not fail
    names = dict.fromkeys(e.name for run in tally.runs for e in run.evidence)
    return {
        "figure": first.figure,
        "protocol": first.protocol,
        "title": first.title,
        "claim": first.claim,
        "outcomes": [run.outcome for run in tally.runs],
        "messages": [run.message for run in tally.runs],
        "reasons": [list(run.reasons) for run in tally.runs],
        "criteria": [
            {
                "name": criterion.name,
                "bound": criterion.bound,
                "limit": criterion.limit,
                "reason": criterion.reason,
                "values": [c and _number(c.value) for c in _over_runs(tally, criterion.name)],
                "passed": [bool(c and c.passed) for c in _over_runs(tally, criterion.name)],
            }
            for criterion in first.criteria
        ],
        "values": {
            name: [_number(run.values.get(name, math.nan)) for run in tally.runs]
            for name in first.values
        },
        "models": [_model(tally, name) for name in names],
    }


def _over_runs(tally: Tally, name: str) -> list[Criterion | None]:
    """The criterion of that name of each run; None if the run failed."""
    return [next((c for c in run.criteria if c.name == name), None) for run in tally.runs]


def _model(tally: Tally, name: str) -> dict[str, Any]:
    """One model over the seeds; None for runs without a model of that name."""
    models = [next((e for e in run.evidence if e.name == name), None) for run in tally.runs]
    known = [e for e in models if e is not None]
    codes = Counter(code for e in known for code in {w.code for w in e.warnings})
    return {
        "name": name,
        "method": known[0].method,
        "order": [e and e.order for e in models],
        "status": [e and e.status for e in models],
        "growth": [e and _number(e.growth) for e in models],
        "sound": [e and e.sound for e in models],
        "decisive": [e and e.decisive for e in models],
        "warnings": dict(sorted(codes.items())),  # number of runs by code
    }


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def comparison_of(
    figure: int,
    *,
    criteria: Sequence[Criterion],
    message: str,
    evidence: Sequence[Evidence] = (),
    values: Mapping[str, float] | None = None,
    plots: Sequence[Figure] = (),
) -> Comparison:
    """Comparison of one figure with its title and claim."""
    claim = _table()["figures"][str(figure)]
    return Comparison(
        figure=figure,
        title=claim["title"],
        claim=claim["claim"],
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        message=message,
        plots=tuple(plots),
        values=values or {},
    )


def failed_comparison(figure: int, error: StrainwaveError) -> Comparison:
    """Comparison of a figure whose estimation failed: the claim is not shown."""
    evidence = Evidence(str(error), "estimation", "failed")
    return comparison_of(figure, criteria=(), message="the estimation failed", evidence=(evidence,))


def criterion_of(key: str, value: float, otherwise: str = "", **names: Any) -> Criterion:
    """Criterion of claims.toml; `names` fill its texts, `otherwise` explains a failure."""
    entry = _table()["criteria"][key]
    name, reason = entry["name"].format(**names), entry["reason"].format(**names)
    return Criterion(name, value, entry["bound"], entry["limit"], reason, otherwise)


@cache
def _table() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name("claims.toml").read_text("utf-8"))


Claim = Mapping[str, Any]
ByProtocol = dict[str, Any]


def to_markdown(document: Mapping[str, Any]) -> str:
    """The page of a run of `python -m reproduction`: verdicts, then the criteria of every figure.

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
