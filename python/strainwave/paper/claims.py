"""Comparisons with the figures of the source, whose titles and claims are in claims.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

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
    claim = _claims()[str(figure)]
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


@cache
def _claims() -> dict[str, dict[str, str]]:
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
