"""Timing by the fastest, least disturbed of several runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


def best_of(
    work: Callable[[], object], *, repeats: int = 7, at_least: float = 0.3, at_most: float = 4.0
) -> float:
    """Least time of `work` [s], over more repeats if it is fast and fewer if it is slow."""
    begin = time.perf_counter()
    times: list[float] = []
    spent = 0.0
    while (len(times) < repeats or spent < at_least) and spent < at_most:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
        spent = time.perf_counter() - begin
    return min(times)


@dataclass(frozen=True)
class Row:
    """Times and errors of strainwave and of a peer for the same work."""

    what: str
    ours: float  # [s]
    peer: str
    peers: float | None  # [s]; None if the peer is not installed
    ours_error: float | None = None  # relative
    peers_error: float | None = None

    def cells(self) -> tuple[str, ...]:
        ours, errors = seconds(self.ours), (percent(self.ours_error), percent(self.peers_error))
        if self.peers is None:
            return self.what, ours, self.peer, "not installed", "", *errors
        ratio = f"{self.peers / self.ours:.3g} x"
        return self.what, ours, self.peer, seconds(self.peers), ratio, *errors


def percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.2g} %"


def seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"
