"""Convert claims over several seeds to comparisons.json."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from strainwave import __version__
from strainwave.domain import Comparison, Tally

SCHEMA = "strainwave/comparisons/2"


def document_of(tallies: Sequence[Tally], seeds: Sequence[int]) -> dict[str, Any]:
    """Claims, outcomes and numbers of every seed as JSON values, without figures.

    `seeds` has the order of each tally's runs. Numbers without a value are None.
    """
    return {
        "schema": SCHEMA,
        "version": __version__,
        "seeds": list(seeds),
        "claims": [_claim(tally) for tally in tallies],
    }


def to_json(document: Mapping[str, Any]) -> bytes:
    """A document as UTF-8 text that ends with a newline."""
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _claim(tally: Tally) -> dict[str, Any]:
    first = max(tally.runs, key=lambda run: len(run.criteria))  # a run that did not fail
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
                "values": [_value(run, criterion.name) for run in tally.runs],
                "passed": [_passed(run, criterion.name) for run in tally.runs],
            }
            for criterion in first.criteria
        ],
        "values": {
            name: [_number(run.values.get(name, math.nan)) for run in tally.runs]
            for name in first.values
        },
        "models": [_model(tally, name) for name in _names(tally)],
    }


def _names(tally: Tally) -> list[str]:
    return list(dict.fromkeys(e.name for run in tally.runs for e in run.evidence))


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


def _value(run: Comparison, name: str) -> float | None:
    return next((_number(c.value) for c in run.criteria if c.name == name), None)


def _passed(run: Comparison, name: str) -> bool:
    return any(c.passed for c in run.criteria if c.name == name)


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None
