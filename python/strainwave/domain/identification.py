"""Result of one run: the results of all stages, the final table and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from strainwave.display import Displayed
from strainwave.domain.diagnostics import published_warnings
from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.final_table import Decision, decide
from strainwave.domain.stage_results import StageResults
from strainwave.domain.verdict import Verdict, compute_verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(StageResults, Displayed):
    """Result of one run; result.json and the report are rendered from it.

    The conclusions from the results of the stages are computed once, at construction.
    """

    created: str  # ISO 8601, UTC
    version: str
    timing_s: Mapping[str, float]
    decisions: tuple[Decision, ...] = field(init=False)  # the final table, each with its reason
    verdict: Verdict = field(init=False)
    warnings: tuple[Diagnostic, ...] = field(init=False)  # that apply to the final table

    def __post_init__(self) -> None:
        """Draw the conclusions."""
        decisions = decide(self)
        verdict = compute_verdict(self, decisions)
        object.__setattr__(self, "decisions", decisions)
        object.__setattr__(self, "verdict", verdict)
        object.__setattr__(self, "warnings", published_warnings(self, decisions, verdict))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The final table: parameters of the whole arm first, then joint by joint.

        The latest stage that estimates a parameter decides it.
        """
        return tuple(decision.parameter for decision in self.decisions)

    @property
    def reason(self) -> str | None:
        """Reasons why the run is not determined, in one sentence; None if it is determined."""
        return "; ".join(self.verdict.reasons) or None
