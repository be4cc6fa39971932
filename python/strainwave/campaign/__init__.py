"""A campaign: many studies identified on this machine or on a cluster, each recorded in a store.

Each run is written to the store by the process that made it, when it ends; what is recorded is not
done again. A study that fails, crashes, hangs or runs out of memory is a row of its own.
"""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from strainwave import pipeline
from strainwave.campaign import cluster, local
from strainwave.campaign.places import Folder, is_url
from strainwave.campaign.plan import Plan
from strainwave.campaign.progress import Tally, live
from strainwave.campaign.store import MERGE_AFTER, Store
from strainwave.campaign.studies import Found, find
from strainwave.campaign.tasks import Limits, Outcome, merged
from strainwave.domain import Options
from strainwave.errors import InvalidInput
from strainwave.io import atomic_files
from strainwave.io.study.flags import Flag, parse_flag

__all__ = ["Limits", "Settings", "Summary", "run"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a campaign does and where."""

    store: str  # path or URL
    stages: Sequence[str] | None = None  # None: as campaign.toml says, or all
    options: Sequence[str] = ()  # "stage.key=value", over those of campaign.toml
    workers: int | None = None  # at a time; None: one per core, or as many as the cluster has
    scheduler: str | None = None  # address of Dask's
    cluster: Path | None = None  # description of a Dask cluster to start
    limits: Limits = field(default_factory=Limits)
    retry_failed: bool = False
    display: bool = False  # of progress, on stderr


@dataclass(frozen=True)
class Summary:
    """What came of a campaign."""

    tally: Tally
    ended_early: str = ""  # why, in one sentence
    unmerged: str = ""  # why small files stay as they are

    @property
    def exit_code(self) -> int:
        """0 where every run is determined, else 3."""
        tally = self.tally
        return 0 if not self.ended_early and tally.by_status["determined"] == tally.total else 3


def run(studies: Sequence[str], settings: Settings) -> Summary:
    """Identify many studies, and record each run in the store as it ends.

    Parameters
    ----------
    studies : sequence of str
        Study files, folders, globs, tables of paths, URLs, or one campaign.toml.
    settings : Settings

    Returns
    -------
    Summary

    Raises
    ------
    InvalidInput
        There is nothing to run, or an argument is at fault.
    """
    found = find(studies)
    if not found.cases:
        raise InvalidInput("there is nothing to run", remedy="name study files, folders or a glob")
    plan = _plan(found, settings)
    tally = Tally(len(found.cases))
    with (
        _outcomes(found, plan, settings) as (outcomes, dashboard),
        live(tally, dashboard) if settings.display else nullcontext(),
    ):
        early = _follow(outcomes, plan.store, tally)
    return Summary(tally, early, "" if early else _merged(plan.store))


def _plan(found: Found, settings: Settings) -> Plan:
    stages = pipeline.check_stages(settings.stages or found.stages or pipeline.STAGES)
    options = merged([found.options, *map(parse_flag, settings.options)])
    Flag(Path("campaign"), "options").options(options, Options())  # a fault of all is said once
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
            remedy="choose another --out or mend its permissions",
        ) from error


@contextmanager
def _outcomes(
    found: Found, plan: Plan, settings: Settings
) -> Iterator[tuple[Iterator[Outcome], str | None]]:
    """Outcomes as they come, and the address of Dask's dashboard."""
    if settings.scheduler is None and settings.cluster is None:
        workers = min(settings.workers or os.cpu_count() or 1, len(found.cases))
        with closing(local.run(found.cases, plan, workers, settings.limits)) as outcomes:
            yield outcomes, None
        return
    with (
        cluster.connected(settings.scheduler, settings.cluster) as client,
        closing(
            cluster.run(found.cases, plan, client, settings.limits, settings.workers)
        ) as outcomes,
    ):
        yield outcomes, client.dashboard_link


def _follow(outcomes: Iterator[Outcome], store: Store, tally: Tally) -> str:
    """Count outcomes; why they ended early, or nothing."""
    merging = _Merging(store)
    try:
        for outcome in outcomes:
            if outcome.unrecorded:
                return (
                    f"the store cannot be written to ({outcome.unrecorded}); "
                    f"{tally.done + tally.skipped} of {tally.total} studies are recorded, and the "
                    "same command goes on from there"
                )
            tally.add(outcome)
            if not outcome.skipped:
                atomic_files.written.append(Path(str(store.place)) / "runs" / outcome.run)
                if tally.done % MERGE_AFTER == 0:
                    merging.begin()
    except cluster.ClusterLost as error:
        return f"{error}; the same command goes on from what is recorded"
    merging.wait()
    return ""


class _Merging:
    """Merges of the store while runs go on: beside the thread that hands out studies."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._thread = threading.Thread()

    def begin(self) -> None:
        """Begin one, unless one is going on."""
        if not self._thread.is_alive():
            self._thread = threading.Thread(target=_merged, args=(self._store,), daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Until the one that is going on has ended."""
        if self._thread.is_alive():
            self._thread.join()


def _merged(store: Store) -> str:
    """Merge small files; what could not be written is left as it was, and said."""
    try:
        store.merge()
    except OSError as error:
        return f"small files of the store could not be merged ({error.strerror or error})"
    return ""
