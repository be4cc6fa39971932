"""Comparisons with the figures of the source; claims.toml lists claims and criteria."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from strainwave.domain import Comparison, Criterion, Evidence
from strainwave.errors import StrainwaveError
from strainwave.presentation.figures import Figure


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
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
