"""Campaigns: many studies identified on this machine or a cluster, each recorded in a store.

The worker process writes a run to the store when it ends. Recorded runs are not repeated. A study
that fails, crashes, hangs or runs out of memory has a row that says so.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from strainwave import pipeline
from strainwave.campaign import cluster, local
from strainwave.campaign.places import Folder, is_url
from strainwave.campaign.progress import Tally, live, reason
from strainwave.campaign.runner import Plan
from strainwave.campaign.store import MERGE_AFTER, Store
from strainwave.campaign.studies import Selection, find
from strainwave.campaign.tasks import Limits, Outcome, merged
from strainwave.domain import Options
from strainwave.errors import InvalidInput
from strainwave.io import atomic_files
from strainwave.io.study.reader import Flag, parse_flag

__all__ = ["Limits", "Settings", "Summary", "run"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Stages, options, workers and store of a campaign."""

    store: str  # path or URL
    stages: Sequence[str] | None = None  # None: those of campaign.toml, or all
    options: Sequence[str] = ()  # "stage.key=value", overriding campaign.toml
    workers: int | None = None  # None: one per core, or all of the cluster
    scheduler: str | None = None  # address of the Dask scheduler
    cluster: Path | None = None  # description of a Dask cluster to start
    limits: Limits = field(default_factory=Limits)
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


def run(studies: Sequence[str] | Selection, settings: Settings) -> Summary:
    """Identify many studies, and record each run in the store when it ends.

    `studies` are study files, folders, globs, tables of paths, URLs, or one campaign.toml; or cases
    of any class that the workers can import. Raises `InvalidInput` if there is no study to run or
    an argument is invalid.
    """
    selection = studies if isinstance(studies, Selection) else find(studies)
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
    return Summary(tally, lines, early, "" if early else _merged(plan.store))


def _plan(selection: Selection, settings: Settings) -> Plan:
    stages = pipeline.check_stages(settings.stages or selection.stages or pipeline.STAGES)
    tables = {"options": selection.options}
    tables |= {f"--set {text}": parse_flag(text) for text in settings.options}
    for place, table in tables.items():  # faults of all studies
        Flag(Path("campaign"), place).options(table, Options())
    options = merged([*tables.values()])
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(3)}"
    where = settings.store
    store = Store.at(where if is_url(where) else Path(where).absolute())
    _check_writable(store)
    return Plan(store, name, stages, options, settings.retry_failed)


def _check_writable(store: Store) -> None:
    if not isinstance(store.place, Folder):
        return
    try:
        (store.place.path / "runs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInput(
            f"cannot write there ({error.strerror or error})",
            where=str(store.place),
            remedy="choose another --out or change its permissions",
        ) from error


@contextmanager
def _outcomes(
    selection: Selection, plan: Plan, settings: Settings
) -> Iterator[tuple[Iterator[Outcome], str | None]]:
    """Outcomes as they come, and the address of the Dask dashboard."""
    if settings.scheduler is None and settings.cluster is None:
        workers = min(settings.workers or os.cpu_count() or 1, len(selection.cases))
        with closing(local.run(selection.cases, plan, workers, settings.limits)) as outcomes:
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
    merging: Future[str] | None = None
    pool = ThreadPoolExecutor(1)  # merges the store while studies run
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
                atomic_files.written.append(Path(str(store.place)) / "runs" / outcome.run)
                is_merging = merging is not None and not merging.done()
                if tally.done % MERGE_AFTER == 0 and not is_merging:
                    merging = pool.submit(_merged, store)
    except cluster.ClusterLost as error:
        return f"{error}; the same command continues from the recorded runs"
    finally:
        pool.shutdown(wait=False)
    if merging is not None:
        merging.result()
    return ""


def _undetermined(tally: Tally, store: Store) -> Iterator[str]:
    """A line per undetermined run: study, status, exit code, reason, and path of its result."""
    listed_runs = tally.undetermined
    if tally.n_undetermined > len(listed_runs):
        yield from tally.causes()
    for outcome in listed_runs:
        result = f"results/{outcome.run}/result.json"
        name = result if store.place.exists(result) else f"runs, run {outcome.run[:8]}"
        yield (
            f"  {outcome.study}: {outcome.status} (exit code {outcome.exit_code}): "
            f"{reason(outcome.message)} [{store.place}/{name}]"
        )
    if tally.n_undetermined > len(listed_runs):
        yield f"  ... and {tally.n_undetermined - len(listed_runs)} more: see sw.read_runs"


def _merged(store: Store) -> str:
    """Merge small files; the reason if that fails, which leaves them unchanged."""
    try:
        store.merge()
    except OSError as error:
        return f"small files of the store could not be merged ({error.strerror or error})"
    return ""
