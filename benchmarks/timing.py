"""Time of a task: the fastest of several runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


def best_of(
    work: Callable[[], object], *, repeats: int = 7, at_least: float = 0.3, at_most: float = 4.0
) -> float:
    """Shortest time of `work` [s], over more repeats if it is fast and fewer if it is slow."""
    begin = time.perf_counter()
    times: list[float] = []
    elapsed = 0.0
    while (len(times) < repeats or elapsed < at_least) and elapsed < at_most:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
        elapsed = time.perf_counter() - begin
    return min(times)


@dataclass(frozen=True)
class Row:
    """Times and errors of strainwave and of a peer for the same work."""

    task: str
    time: float  # [s]
    peer: str
    peer_time: float | None  # [s]; None if the peer is not installed
    error: float | None = None  # relative
    peer_error: float | None = None

    def cells(self) -> tuple[str, ...]:
        time, errors = seconds(self.time), (percent(self.error), percent(self.peer_error))
        if self.peer_time is None:
            return self.task, time, self.peer, "not installed", "", *errors
        ratio = f"{self.peer_time / self.time:.3g} x"
        return self.task, time, self.peer, seconds(self.peer_time), ratio, *errors


def percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.2g} %"


def seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"
