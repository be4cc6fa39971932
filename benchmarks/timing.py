"""Timing by the best of several runs: the least disturbed one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


def best_of(
    work: Callable[[], object], *, repeats: int = 7, at_least: float = 0.3, at_most: float = 4.0
) -> float:
    """Least time [s] that `work` took; more repeats where it is quick, fewer where it is slow."""
    begun = time.perf_counter()
    times: list[float] = []
    spent = 0.0
    while (len(times) < repeats or spent < at_least) and spent < at_most:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
        spent = time.perf_counter() - begun
    return min(times)


@dataclass(frozen=True)
class Row:
    """Our time beside a peer's, for the same work."""

    what: str
    ours: float  # [s]
    peer: str
    peers: float | None  # [s]; None where the peer is not there

    def cells(self) -> tuple[str, str, str, str, str]:
        if self.peers is None:
            return self.what, seconds(self.ours), self.peer, "not there", ""
        ratio = f"{self.peers / self.ours:.3g} x"
        return self.what, seconds(self.ours), self.peer, seconds(self.peers), ratio


def seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"
