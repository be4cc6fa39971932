"""Test of a published claim: its criteria, the models behind them, and the outcome."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from strainwave.domain.results.estimates import Diagnostic

Outcome = Literal["shown", "not-shown", "does-not-hold"]
Protocol = Literal["own", "as-published"]

OUTCOME_TEXTS: dict[Outcome, str] = {
    "shown": "shown",
    "not-shown": "not shown",
    "does-not-hold": "does not hold",
}
"""Texts of the outcomes."""

_USABLE_STATUSES = ("estimated", "converged", "determined", "partly-determined")


@dataclass(frozen=True, slots=True)
class Criterion:
    """One number that decides on a claim."""

    name: str  # of the measured quantity, with its unit
    value: float  # NaN: no value; infinite: an estimate lacks the compared quantity
    bound: Literal["at least", "at most"]
    limit: float
    reason: str  # of the limit
    otherwise: str = ""  # explanation of a failure

    @property
    def passed(self) -> bool:
        """Whether the value satisfies the limit; NaN does not."""
        return self.value >= self.limit if self.bound == "at least" else self.value <= self.limit


@dataclass(frozen=True, slots=True)
class Evidence:
    """One estimated model of a figure, and whether the claim may rely on it."""

    name: str
    method: str
    status: str  # of the model, or "failed"
    order: int | None = None  # of a state-space model
    growth: float = math.nan  # largest modulus of the discrete-time poles; above 1: unstable
    warnings: tuple[Diagnostic, ...] = ()
    decisive: bool = True  # whether the claim relies on the model; else it is only plotted

    @property
    def sound(self) -> bool:
        """Whether the model converged and is stable.

        A model that is implausible or at the published bounds is usable if only its response
        counts, which requires `growth`.
        """
        if self.status in ("implausible", "at-bounds"):
            return self.growth <= 1.0
        return self.status in _USABLE_STATUSES and not self.growth > 1.0

    @property
    def fault(self) -> str:
        """Reason why the model is not usable; empty if it is."""
        if self.sound:
            return ""
        if self.growth > 1.0:
            return f"{self.name}: unstable, pole of modulus {self.growth:.3f}"
        return f"{self.name}: {self.status}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """One claim of the source, tested on an arm with known true values."""

    figure: int  # of the source
    title: str
    claim: str  # in one sentence
    criteria: tuple[Criterion, ...]
    evidence: tuple[Evidence, ...]  # all estimated models behind the claim
    message: str  # result on this arm
    plots: tuple[Any, ...]  # figures of `strainwave.report`, a higher layer
    values: Mapping[str, float] = field(default_factory=dict)  # further numbers; NaN: no value
    protocol: Protocol = "own"  # source of the settings

    @property
    def outcome(self) -> Outcome:
        """Value "not-shown" if the claim relies on a model that did not converge or is unstable."""
        if not self.criteria or not all(e.sound for e in self.evidence if e.decisive):
            return "not-shown"
        return "shown" if all(c.passed for c in self.criteria) else "does-not-hold"

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why the claim is not shown or does not hold; empty if it is shown."""
        if self.outcome == "not-shown":
            return tuple(e.fault for e in self.evidence if e.decisive and not e.sound)
        return tuple(_failure(c) for c in self.criteria if not c.passed)


@dataclass(frozen=True, slots=True)
class Tally:
    """One claim over several seeds of sensor noise and motions."""

    runs: tuple[Comparison, ...]  # one per seed, of one figure and one protocol

    @property
    def first(self) -> Comparison:
        """Result of the first seed, with its plots."""
        return self.runs[0]

    def count(self, outcome: Outcome) -> int:
        """Number of runs with an outcome."""
        return sum(run.outcome == outcome for run in self.runs)

    def is_mostly(self, outcome: Outcome) -> bool:
        """Whether more than half of the runs have an outcome."""
        return 2 * self.count(outcome) > len(self.runs)

    @property
    def verdict(self) -> str:
        """Text of the outcomes."""
        return outcomes_text([run.outcome for run in self.runs])


def outcomes_text(outcomes: Sequence[Outcome]) -> str:
    """Text of one outcome, or of several with counts: "shown 8/10, not shown 2/10"."""
    counts = {outcome: outcomes.count(outcome) for outcome in OUTCOME_TEXTS}
    if len(outcomes) == 1:
        return OUTCOME_TEXTS[outcomes[0]]
    return ", ".join(
        f"{word} {counts[outcome]}/{len(outcomes)}"
        for outcome, word in OUTCOME_TEXTS.items()
        if counts[outcome]
    )


def _failure(criterion: Criterion) -> str:
    value = "none" if not math.isfinite(criterion.value) else f"{criterion.value:.5g}"
    text = f"{criterion.name} {value}, expected {criterion.bound} {criterion.limit:g}"
    return f"{text} ({criterion.otherwise})" if criterion.otherwise else text
