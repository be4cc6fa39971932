"""Progress of a campaign: counts, undetermined runs, and a live display."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

from strainwave.campaign.tasks import FAILED_STATUS, Outcome

_PATH = re.compile(r"\S*/\S*|\S+\.(?:toml|csv|parquet)\S*")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_MAX_CAUSE_LENGTH = 90  # characters: one line of a terminal
_MAX_CAUSES = 6  # displayed
MAX_LISTED_RUNS = 20
"""Undetermined runs that are listed by name: a screen."""
STATUSES = (
    "determined",
    "partly-determined",
    "not-determined",
    "inconsistent-input",
    FAILED_STATUS,
)


@dataclass
class Tally:
    """Counts of the outcomes of a campaign so far."""

    total: int
    start: float = field(default_factory=time.monotonic)
    done: int = 0  # in this campaign
    skipped: int = 0  # recorded before
    by_status: Counter[str] = field(default_factory=Counter)
    by_cause: Counter[tuple[str, str]] = field(default_factory=Counter)
    undetermined: list[Outcome] = field(default_factory=list)  # the first `MAX_LISTED`

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self.done += not outcome.skipped
        self.skipped += outcome.skipped
        self.by_status[outcome.status] += 1
        if outcome.status != "determined":
            self.by_cause[outcome.status, cause(outcome.message)] += 1
            if len(self.undetermined) < MAX_LISTED_RUNS:
                self.undetermined.append(outcome)

    @property
    def n_undetermined(self) -> int:
        """Number of runs that are not determined or failed."""
        return self.by_status.total() - self.by_status["determined"]

    @property
    def seconds(self) -> float:
        """Time since the start of the campaign."""
        return time.monotonic() - self.start

    @property
    def rate(self) -> float:
        """Runs per second."""
        return self.done / max(self.seconds, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """Remaining time at the present rate; None before the first run ends."""
        waiting = self.total - self.done - self.skipped
        return waiting / self.rate if self.done else None

    @property
    def counts(self) -> str:
        """Number of runs of each status."""
        return ", ".join(f"{self.by_status[s]} {s}" for s in STATUSES if self.by_status[s])

    def line(self) -> str:
        """The counts in one line."""
        skipped = f", {self.skipped} of them recorded before" if self.skipped else ""
        return (
            f"{self.done + self.skipped} of {self.total} studies{skipped}: "
            f"{self.counts or 'none'}; {self.seconds:.1f} s, {self.rate:.2f} runs/s"
        )

    def causes(self) -> list[str]:
        """The most frequent causes of undetermined runs, one line each."""
        common = self.by_cause.most_common(_MAX_CAUSES)
        return [f"  {count} {status}: {reason}" for (status, reason), count in common]


def cause(message: str) -> str:
    """A message without file names and numbers, which differ between studies of one cause."""
    text = _NUMBER.sub("#", _PATH.sub("...", reason(message)))
    return text if len(text) <= _MAX_CAUSE_LENGTH else text[: _MAX_CAUSE_LENGTH - 3] + "..."


def reason(message: str) -> str:
    """A message without its remedy, on one line."""
    return " ".join(message.split(" Remedy:", maxsplit=1)[0].split())


@contextmanager
def live(tally: Tally, dashboard: str | None) -> Iterator[None]:
    """Display a tally on stderr; `dashboard` is the address of the Dask dashboard."""
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True, highlight=False)
    with Live(console=console, get_renderable=lambda: _display(tally, dashboard)):
        yield


def _display(tally: Tally, dashboard: str | None) -> Any:
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.text import Text

    ended = tally.done + tally.skipped
    left = tally.seconds_left
    time_left = "" if left is None else f", {timedelta(seconds=round(left))} left"
    lines = [
        Text(f"{ended} of {tally.total} studies, {tally.rate:.2f} runs/s{time_left}"),
        Text(tally.counts),
        *map(Text, tally.causes()),
    ]
    if dashboard:
        lines.append(Text(f"Dask: {dashboard}"))
    return Group(ProgressBar(total=max(tally.total, 1), completed=ended), *lines)
