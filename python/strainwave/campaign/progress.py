"""How far a campaign is: counts while it runs, a live display where a person watches."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from strainwave.campaign.tasks import FAILED, Outcome

_PLACE = re.compile(r"\S*/\S*|\S+\.(?:toml|csv|parquet)\S*")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_LONGEST = 90  # characters of a cause
_CAUSES = 6  # that are displayed
STATUSES = ("determined", "partly-determined", "not-determined", "inconsistent-input", FAILED)


@dataclass
class Tally:
    """What has come of a campaign's cases so far."""

    total: int
    begin: float = field(default_factory=time.monotonic)
    done: int = 0  # in this campaign
    skipped: int = 0  # recorded before
    by_status: Counter[str] = field(default_factory=Counter)
    by_cause: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add(self, outcome: Outcome) -> None:
        """Count an outcome.

        Parameters
        ----------
        outcome : Outcome
        """
        self.done += not outcome.skipped
        self.skipped += outcome.skipped
        self.by_status[outcome.status] += 1
        if outcome.status != "determined":
            self.by_cause[outcome.status, cause(outcome.message)] += 1

    @property
    def seconds(self) -> float:
        """Since the campaign began."""
        return time.monotonic() - self.begin

    @property
    def rate(self) -> float:
        """Runs per second."""
        return self.done / max(self.seconds, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """At the rate so far; None before the first run has ended."""
        waiting = self.total - self.done - self.skipped
        return waiting / self.rate if self.done else None

    def line(self) -> str:
        """The counts in one line."""
        counts = ", ".join(f"{self.by_status[s]} {s}" for s in STATUSES if self.by_status[s])
        skipped = f", {self.skipped} of them recorded before" if self.skipped else ""
        return (
            f"{self.done + self.skipped} of {self.total} studies{skipped}: {counts or 'none'}; "
            f"{self.seconds:.1f} s, {self.rate:.2f} runs/s"
        )

    def causes(self) -> list[str]:
        """The commonest causes of what is not determined, a line each."""
        common = self.by_cause.most_common(_CAUSES)
        return [f"  {count} {status}: {why}" for (status, why), count in common]


def cause(message: str) -> str:
    """The class of a message: without names of files and numbers, which differ by study.

    Parameters
    ----------
    message : str

    Returns
    -------
    str
    """
    text = _NUMBER.sub("#", _PLACE.sub("...", message.split(" Remedy:", maxsplit=1)[0]))
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


@contextmanager
def live(tally: Tally, dashboard: str | None) -> Iterator[None]:
    """Display a tally on stderr while it changes.

    Parameters
    ----------
    tally : Tally
    dashboard : str, optional
        Address of Dask's own page.

    Yields
    ------
    None
    """
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
    time_left = "" if left is None else f", {_clock(left)} left"
    lines = [
        Text(f"{ended} of {tally.total} studies, {tally.rate:.2f} runs/s{time_left}"),
        Text(", ".join(f"{tally.by_status[s]} {s}" for s in STATUSES if tally.by_status[s])),
    ]
    lines += [Text(line) for line in tally.causes()]
    if dashboard:
        lines.append(Text(f"Dask: {dashboard}"))
    return Group(ProgressBar(total=max(tally.total, 1), completed=ended), *lines)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
