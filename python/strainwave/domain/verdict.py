"""Verdict on a run, shared by exit code, result.json, terminal output and report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from strainwave.domain.estimates import Suspicion

Status = Literal["determined", "partly-determined", "not-determined", "inconsistent-input"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Validation:
    """Whether validation records excite each model and the model predicts them."""

    rigid: bool
    elastic: bool  # for every joint with an elastic gear


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict on a run, as defined in docs/result.md.

    Parameters are listed by name and joint, as in "gear_stiffness 1". Parameters of the whole arm
    have no number.
    """

    status: Status
    identified: tuple[str, ...]
    not_identified: tuple[str, ...]  # null, or with too wide an interval
    rejected: tuple[str, ...]  # null because the estimate is invalid
    validated: Validation
    suspected: tuple[Suspicion, ...] = ()
    reasons: tuple[str, ...] = ()  # why the status is not "determined", most important first

    @property
    def exit_code(self) -> int:
        """0 if the status is "determined", otherwise 3."""
        return 0 if self.status == "determined" else 3
