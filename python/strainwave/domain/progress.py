"""The stages of an identification, and the progress of a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args


@dataclass(frozen=True, slots=True)
class ProgressEvent:
    """Start of a part of a run, or a step within it."""

    stage: str  # "read", "consistency", "rigid", "checks", "decoupled", "tuned", "report"
    fraction: float  # completed parts over all parts, from 0 to 1
    message: str  # current activity
    part: int  # from 1; parts that cannot run are skipped
    parts: int

    def __str__(self) -> str:
        return f"{self.part} of {self.parts}: {self.message}"


Progress = Callable[[ProgressEvent], None]
"""Called at the start of each part of a run, and at each evaluation of the whole-arm fit."""


def ignore_progress(_event: ProgressEvent) -> None:
    """Ignore progress events."""


Stage = Literal["rigid", "decoupled", "tuned"]
STAGES: tuple[Stage, ...] = get_args(Stage)
"""All stages in order; a run executes a prefix of them."""
