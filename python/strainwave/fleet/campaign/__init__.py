"""Campaigns: many studies identified on this machine or a cluster, each recorded in a store.

The worker process writes a run to the store when it ends. Recorded runs are not repeated. A study
that fails, crashes, hangs or runs out of memory has a row that says so.
"""

from __future__ import annotations

import os
import re
import secrets
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from strainwave import pipeline
from strainwave.domain import Options
from strainwave.errors import InvalidInput
from strainwave.fleet.campaign import cluster, runner
from strainwave.fleet.campaign.records import FAILED_STATUS, Outcome, RunLimits, merged
from strainwave.fleet.campaign.runner import CampaignPlan
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import CaseSelection, find, is_url
from strainwave.io import atomic_files
from strainwave.io.study.reader import Reader, parse_flag
from strainwave.numerics.dask_cluster import ClusterLost

__all__ = ["RunLimits", "Settings", "Summary", "run"]

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
    undetermined: list[Outcome] = field(default_factory=list)  # the first `MAX_LISTED_RUNS`

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


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Stages, options, workers and store of a campaign."""

    store: str  # path or URL
    stages: Sequence[str] | None = None  # None: those of campaign.toml, or all
    options: Sequence[str] = ()  # "stage.key=value", overriding campaign.toml
    workers: int | None = None  # None: one per core, or all of the cluster
    scheduler: str | None = None  # address of the Dask scheduler
    cluster: Path | None = None  # description of a Dask cluster to start
    limits: RunLimits = field(default_factory=RunLimits)
    retry_failed: bool = False
    display: bool = False  # show progress on stderr


@dataclass(frozen=True)
class Summary:
    """Outcome of a campaign."""

    tally: Tally
    undetermined: tuple[str, ...] = ()  # a line per run that is not determined or failed
    ended_early: str = ""  # reason, in one sentence
    unmerged: str = ""  # why small files were not merged

    @property
    def exit_code(self) -> int:
        """0 if every run is determined, else 3."""
        tally = self.tally
        return 0 if not self.ended_early and tally.by_status["determined"] == tally.total else 3


def run(studies: Sequence[str] | CaseSelection, settings: Settings) -> Summary:
    """Identify many studies, and record each run in the store when it ends.

    `studies` are study files, folders, globs, tables of paths, URLs, or one campaign.toml; or cases
    of any class that the workers can import. Raises `InvalidInput` if there is no study to run or
    an argument is invalid.
    """
    selection = studies if isinstance(studies, CaseSelection) else find(studies)
    if not selection.cases:
        raise InvalidInput("there is no study to run", remedy="give study files, folders or a glob")
    plan = _plan(selection, settings)
    tally = Tally(len(selection.cases))
    with (
        _outcomes(selection, plan, settings) as (outcomes, dashboard),
        live(tally, dashboard) if settings.display else nullcontext(),
    ):
        early = _follow(outcomes, plan.store, tally)
    lines = tuple(_undetermined(tally, plan.store))
    return Summary(tally, lines, early, "" if early else _merge(plan.store))


def _plan(selection: CaseSelection, settings: Settings) -> CampaignPlan:
    stages = pipeline.check_stages(settings.stages or selection.stages or pipeline.STAGES)
    tables = {"options": selection.options}
    tables |= {f"--set {text}": parse_flag(text) for text in settings.options}
    for place, table in tables.items():  # faults of all studies
        Reader(Path("campaign"), "", flag=place).options(table, Options())
    options = merged([*tables.values()])
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(3)}"
    where = settings.store
    if not is_url(where):
        where = str(Path(where).absolute())
        try:
            Path(where, "runs").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(
                f"cannot write there ({error.strerror or error})",
                where=where,
                remedy="choose another --out or change its permissions",
            ) from error
    return CampaignPlan(Store(where), name, stages, options, settings.retry_failed)


@contextmanager
def _outcomes(
    selection: CaseSelection, plan: CampaignPlan, settings: Settings
) -> Iterator[tuple[Iterator[Outcome], str | None]]:
    if settings.scheduler is None and settings.cluster is None:
        workers = min(settings.workers or os.cpu_count() or 1, len(selection.cases))
        with closing(runner.run(selection.cases, plan, workers, settings.limits)) as outcomes:
            yield outcomes, None
        return
    with (
        cluster.connected(settings.scheduler, settings.cluster) as client,
        closing(
            cluster.run(selection.cases, plan, client, settings.limits, settings.workers)
        ) as outcomes,
    ):
        yield outcomes, client.dashboard_link


def _follow(outcomes: Iterator[Outcome], store: Store, tally: Tally) -> str:
    """Count outcomes; the reason if they end early, or ""."""
    try:
        for outcome in outcomes:
            if outcome.unrecorded:
                return (
                    f"the store cannot be written to ({outcome.unrecorded}); "
                    f"{tally.done + tally.skipped} of {tally.total} studies are recorded; the same "
                    "command continues there"
                )
            tally.add(outcome)
            if not outcome.skipped:
                atomic_files.written.append(Path(store.where) / "runs" / outcome.run)
    except ClusterLost as error:
        return f"{error}; the same command continues from the recorded runs"
    return ""


def _undetermined(tally: Tally, store: Store) -> Iterator[str]:
    """A line per undetermined run: study, status, exit code, reason, and path of its result."""
    listed_runs = tally.undetermined
    if tally.n_undetermined > len(listed_runs):
        yield from tally.causes()
    for outcome in listed_runs:
        result = f"results/{outcome.run}/result.json"
        name = result if store.exists(result) else f"runs, run {outcome.run[:8]}"
        yield (
            f"  {outcome.study}: {outcome.status} (exit code {outcome.exit_code}): "
            f"{reason(outcome.message)} [{store.where}/{name}]"
        )
    if tally.n_undetermined > len(listed_runs):
        yield f"  ... and {tally.n_undetermined - len(listed_runs)} more: see sw.read_runs"


def _merge(store: Store) -> str:
    """Merge small files; the reason if that fails, which leaves them unchanged."""
    try:
        store.merge()
    except OSError as error:
        return f"small files of the store could not be merged ({error.strerror or error})"
    return ""
