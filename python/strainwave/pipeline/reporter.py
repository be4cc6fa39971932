"""Times and progress of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from strainwave.domain import Clause, Stage
from strainwave.domain.study import Progress, ProgressEvent
from strainwave.errors import NumericalFailure

T = TypeVar("T")


def attempt(stage: Callable[[], T], failed: Callable[[Clause], T]) -> T:
    """The result of a stage, or of `failed` with the reason if its computation fails."""
    try:
        return stage()
    except NumericalFailure as failure:
        return failed(Clause("numerical-failure", reason=str(failure)))


class Reporter:
    """Measures the times of the parts of a run and reports its progress."""

    def __init__(self, stages: Sequence[Stage], progress: Progress) -> None:
        self.timing_s: dict[str, float] = {}
        planned = ["read", "consistency", "rigid", "checks"]
        if "decoupled" in stages:
            planned.append("decoupled")
        if "tuned" in stages:
            planned += ["tuned", "checks"]
        self._planned = [*planned, "report"]
        self._progress = progress
        self._n_started = 0  # parts started or skipped
        self._fraction = 0.0  # completed part of the run, from 0 to 1

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
        if part in self._planned[self._n_started :]:
            self._n_started = self._planned.index(part, self._n_started) + 1
        parts = len(self._planned)
        fraction = (self._n_started - 1 + min(within, 1.0)) / parts
        self._fraction = max(self._fraction, fraction)  # never decreases if a part takes longer
        self._progress(ProgressEvent(part, self._fraction, activity, self._n_started, parts))
