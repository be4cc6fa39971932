"""The verdict on a run: what exit code, result.json, terminal and report all say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from strainwave.domain.estimates import Suspicion

Status = Literal["determined", "partly-determined", "not-determined", "inconsistent-input"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Validated:
    """Whether check records exercised each model."""

    rigid: bool
    elastic: bool  # every joint with an elastic gear


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What a run answered, by docs/result.md.

    Parameters stand by name and joint: "gear_stiffness 1"; those of the arm without a number.
    """

    status: Status
    identified: tuple[str, ...]
    not_identified: tuple[str, ...]  # null, or too uncertain to count
    rejected: tuple[str, ...]  # null because a value was found that cannot be right
    validated: Validated
    suspected: tuple[Suspicion, ...] = ()
    reasons: tuple[str, ...] = ()  # why not "determined", the first the most important

    @property
    def exit_code(self) -> int:
        """0 for a determined arm, else 3."""
        return 0 if self.status == "determined" else 3
