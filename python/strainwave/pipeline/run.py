"""The state of a run: intermediate results, warnings, times and progress."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, fields

from strainwave.domain import Diagnostic, JointModel, LinkSummary
from strainwave.domain.keys import Key
from strainwave.domain.progress import Progress, ProgressEvent
from strainwave.dynamics.arm import Arm


@dataclass
class Run:
    """Intermediate results, warnings, times and progress of a run."""

    stages: tuple[str, ...]
    progress: Progress
    arm: Arm = field(init=False)  # set when the study is read
    parts: list[str] = field(default_factory=list)  # started or skipped
    warnings: list[Diagnostic] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    sensors: dict[Key, float] = field(default_factory=dict)  # estimated delays
    links: tuple[LinkSummary, ...] = ()
    others: list[tuple[JointModel, ...]] = field(default_factory=list)  # further starts of the fit
    timing_s: dict[str, float] = field(default_factory=dict)
    fraction: float = 0.0  # completed part of the run, from 0 to 1

    def copy_state(self) -> Run:
        """Copy the present state, for `restore`."""
        duplicate = copy(self)
        for member in fields(self):
            value = getattr(self, member.name)
            if isinstance(value, list | dict):
                setattr(duplicate, member.name, value.copy())
        return duplicate

    def restore(self, state: Run) -> None:
        """Return to an earlier copy, but keep times and progress."""
        for member in fields(self):
            if member.name not in ("parts", "timing_s", "fraction"):
                setattr(self, member.name, getattr(state, member.name))

    @contextmanager
    def time_part(self, part: str, activity: str) -> Iterator[None]:
        """Report the start of a part and measure its time."""
        self.report(part, activity)
        with self.measure_time(part):
            yield

    @contextmanager
    def measure_time(self, part: str) -> Iterator[None]:
        """Measure the time of a part that runs in parallel to another part."""
        begin = time.perf_counter()
        yield
        self.timing_s[part] = self.timing_s.get(part, 0.0) + time.perf_counter() - begin

    def report(self, part: str, activity: str, within: float = 0.0) -> None:
        """Report progress; `within` is the completed part of this part, from 0 to 1.

        Planned parts before this one that have not started count as skipped.
        """
        planned = planned_parts(self.stages)
        started = len(self.parts)
        if part in planned[started:]:
            self.parts = planned[: planned.index(part, started) + 1]
        number, parts = len(self.parts), len(planned)
        fraction = (number - 1 + min(within, 1.0)) / parts
        self.fraction = max(self.fraction, fraction)  # never decreases if a part takes longer
        self.progress(ProgressEvent(part, self.fraction, activity, number, parts))


def planned_parts(stages: Sequence[str]) -> list[str]:
    """The timed parts of a run, in order; "checks" occurs twice with the last stage."""
    planned = ["read", "consistency", "rigid", "checks"]
    if "decoupled" in stages:
        planned.append("decoupled")
    if "tuned" in stages:
        planned += ["tuned", "checks"]
    return [*planned, "report"]
