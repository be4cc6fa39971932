"""A run while it lasts: what the stages leave for later ones, warnings, times and progress."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, fields

from strainwave.domain import Diagnostic, JointModel, LinkSummary
from strainwave.domain.progress import Progress, ProgressEvent
from strainwave.dynamics.arm import Arm


@dataclass
class Run:
    """What accumulates while the stages run, and how far they are."""

    stages: tuple[str, ...]
    progress: Progress
    arm: Arm = field(init=False)  # as soon as the study is read
    parts: list[str] = field(default_factory=list)  # that have begun, or been passed over
    warnings: list[Diagnostic] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    sensors: dict[tuple[str, int | None], float] = field(default_factory=dict)  # delays found
    links: tuple[LinkSummary, ...] = ()
    others: list[tuple[JointModel, ...]] = field(default_factory=list)  # more starts of the fit
    timing_s: dict[str, float] = field(default_factory=dict)
    fraction: float = 0.0  # of the run that is done

    def copied(self) -> Run:
        """The run as it is, to come back to."""
        found = copy(self)
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, list | dict):
                setattr(found, each.name, value.copy())
        return found

    def forget(self, since: Run) -> None:
        """Be as at a copy made earlier, but for the time taken and how far the run is."""
        for each in fields(self):
            if each.name not in ("parts", "timing_s", "fraction"):
                setattr(self, each.name, getattr(since, each.name))

    @contextmanager
    def timed(self, part: str, said: str) -> Iterator[None]:
        """Say that a part begins, and add the time that it takes.

        `part`: One of those that are planned.
        `said`: What is done in it.
        """
        self.report(part, said)
        with self.clocked(part):
            yield

    @contextmanager
    def clocked(self, part: str) -> Iterator[None]:
        """Add the time of work for a part that is done beside another part."""
        begin = time.perf_counter()
        yield
        self.timing_s[part] = self.timing_s.get(part, 0.0) + time.perf_counter() - begin

    def report(self, part: str, said: str, within: float = 0.0) -> None:
        """Say what is being done, and how far that is: parts that cannot run are passed over.

        `within`: How much of the part is done, from 0 to 1.
        """
        planned = planned_parts(self.stages)
        begun = len(self.parts)
        if part in planned[begun:]:
            self.parts = planned[: planned.index(part, begun) + 1]
        number, parts = len(self.parts), len(planned)
        reached = (number - 1 + min(within, 1.0)) / parts
        self.fraction = max(self.fraction, reached)  # a part may turn out to be longer
        self.progress(ProgressEvent(part, self.fraction, said, number, parts))


def planned_parts(stages: Sequence[str]) -> list[str]:
    """The timed parts of a run, in order; a part may come twice."""
    planned = ["read", "consistency", "rigid", "checks"]
    if "decoupled" in stages:
        planned.append("decoupled")
    if "tuned" in stages:
        planned += ["tuned", "checks"]
    return [*planned, "report"]
