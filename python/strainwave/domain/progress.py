"""What a run is doing, as it goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ProgressEvent:
    """The beginning of a part of a run, or a step within it."""

    stage: str  # "read", "consistency", "rigid", "checks", "decoupled", "tuned", "report"
    fraction: float  # of all parts, by number: 0 at the start, 1 at the end
    message: str  # what is being done
    part: int  # from 1; parts that cannot run are passed over
    parts: int

    def __str__(self) -> str:
        return f"{self.part} of {self.parts}: {self.message}"


Progress = Callable[[ProgressEvent], None]
"""Called at the start of each part of a run, and at each evaluation of the whole-arm fit."""


def ignored(_event: ProgressEvent) -> None:
    """Progress that nobody follows."""
