"""A published claim put to the test: what it is judged by, what it rests on, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from strainwave.domain.estimates import Diagnostic

Outcome = Literal["shown", "not-shown", "does-not-hold"]
Protocol = Literal["own", "as-published"]

OUTCOMES: dict[Outcome, str] = {
    "shown": "shown",
    "not-shown": "not shown",
    "does-not-hold": "does not hold",
}
"""Verdicts in words."""

_SOUND = ("estimated", "converged", "determined", "partly-determined")


@dataclass(frozen=True, slots=True)
class Criterion:
    """One number that a claim stands or falls by."""

    name: str  # what is measured, with its unit
    value: float  # NaN: there is none; infinite: an estimate lacks what is compared
    bound: Literal["at least", "at most"]
    limit: float
    reason: str  # for the limit
    otherwise: str = ""  # why it fails, where it does

    @property
    def passed(self) -> bool:
        """Whether the value keeps the limit; one that does not exist never does."""
        return self.value >= self.limit if self.bound == "at least" else self.value <= self.limit


@dataclass(frozen=True, slots=True)
class Evidence:
    """One estimated model that a figure shows, and whether it may be relied on."""

    name: str
    method: str
    status: str  # as the model says, or "failed"
    order: int | None = None  # of a state-space model
    growth: float = math.nan  # largest modulus of its sampled poles: above one it is unstable
    warnings: tuple[Diagnostic, ...] = ()
    decisive: bool = True  # whether the claim rests on it; else it is only shown beside

    @property
    def sound(self) -> bool:
        """Whether it converged and is stable.

        One that is implausible, or at the end of ranges that belong to the method, will do where
        only its response counts: `growth` is given.
        """
        if self.status in ("implausible", "at-bounds"):
            return self.growth <= 1.0
        return self.status in _SOUND and not self.growth > 1.0

    @property
    def fault(self) -> str:
        """Why it is not to be relied on; empty if it is."""
        if self.sound:
            return ""
        if self.growth > 1.0:
            return f"{self.name}: unstable, pole of modulus {self.growth:.3f}"
        return f"{self.name}: {self.status}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """One claim of the source, put to an arm whose truth is known."""

    figure: int  # of the source that makes the claim
    title: str
    claim: str  # in one sentence
    criteria: tuple[Criterion, ...]
    evidence: tuple[Evidence, ...]  # every estimated model behind it
    message: str  # what the arm shows
    plots: tuple[Any, ...]  # figures of `strainwave.presentation`, which lies above
    values: Mapping[str, float] = field(default_factory=dict)  # further numbers; NaN: there is none
    protocol: Protocol = "own"  # whose settings

    @property
    def outcome(self) -> Outcome:
        """Not shown where it rests on a model that did not converge or is unstable."""
        if not self.criteria or not all(e.sound for e in self.evidence if e.decisive):
            return "not-shown"
        return "shown" if all(c.passed for c in self.criteria) else "does-not-hold"

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not shown, or does not hold; empty if it is shown."""
        if self.outcome == "not-shown":
            return tuple(e.fault for e in self.evidence if e.decisive and not e.sound)
        return tuple(_failure(c) for c in self.criteria if not c.passed)


@dataclass(frozen=True, slots=True)
class Tally:
    """One claim over several seeds of sensors' noise and of motions."""

    runs: tuple[Comparison, ...]  # one per seed, of one figure and one protocol

    @property
    def first(self) -> Comparison:
        """Of the first seed, with its plots."""
        return self.runs[0]

    def count(self, outcome: Outcome) -> int:
        """In how many runs the claim came out so."""
        return sum(run.outcome == outcome for run in self.runs)

    @property
    def verdict(self) -> str:
        """How often it came out how, in words."""
        return outcomes_text([run.outcome for run in self.runs])


def outcomes_text(outcomes: Sequence[Outcome]) -> str:
    """One verdict as it is, several with their counts: "shown 8/10, not shown 2/10"."""
    counted = {outcome: outcomes.count(outcome) for outcome in OUTCOMES}
    if len(outcomes) == 1:
        return OUTCOMES[outcomes[0]]
    return ", ".join(
        f"{word} {counted[outcome]}/{len(outcomes)}"
        for outcome, word in OUTCOMES.items()
        if counted[outcome]
    )


def _failure(criterion: Criterion) -> str:
    value = "none" if not math.isfinite(criterion.value) else f"{criterion.value:.5g}"
    text = f"{criterion.name} {value}, expected {criterion.bound} {criterion.limit:g}"
    return f"{text} ({criterion.otherwise})" if criterion.otherwise else text
