"""A campaign on a Dask cluster: each thread of a Dask worker has a worker process of its own.

What is sent is a line of JSON each way; studies and the store are reached by path or URL from
wherever a worker runs.
"""

from __future__ import annotations

import importlib
import logging
import queue
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from strainwave.campaign.cases import Case
from strainwave.campaign.plan import Plan
from strainwave.campaign.rows import now
from strainwave.campaign.runner import Runner, failed
from strainwave.campaign.store import Store
from strainwave.campaign.tasks import FAILED, Limits, Outcome, Task
from strainwave.errors import InvalidInput, StrainwaveError
from strainwave.io.atomic_files import decode, read_bytes
from strainwave.io.toml_files import check_keys, parsed_toml

_CONNECT = 10.0  # [s] for a scheduler to answer
_POLL = 0.5  # [s] between two looks at whether it is still there
_MISSING = 10.0  # [s] without the scheduler, after which it is given up
_AHEAD = 2  # tasks per thread of the cluster that wait there
_LEAST_AHEAD = 16
_PLANNERS = 4  # threads that look what is recorded
_KEYS = ("class", "arguments", "workers")

_own = threading.local()


class ClusterLost(StrainwaveError):  # noqa: N818
    """The scheduler has gone; the same command goes on where this one ended."""

    def __init__(self) -> None:
        super().__init__("the Dask scheduler has gone")


def perform(line: str, limits: dict[str, Any], since: str) -> str:
    """What a Dask worker does: one task in the worker process of this thread.

    Parameters
    ----------
    line : str
        Of a task.
    limits : dict
        Of `Limits`.
    since : str
        ISO 8601: when the task was planned. A run recorded later is this task's, done by a worker
        process whose Dask worker has died meanwhile.

    Returns
    -------
    str
        An outcome as JSON.
    """
    task = Task.from_json(line)
    known = _store(task.store).recorded(task.run)
    if known and (known.status != FAILED or known.started >= datetime.fromisoformat(since)):
        return Outcome.of(task.run, task.case.name, known).to_json()
    if getattr(_own, "limits", None) != limits:
        _own.limits, _own.runner = limits, Runner(Limits(**limits))
    runner: Runner = _own.runner
    return runner.run(task).to_json()


@cache
def _store(where: str) -> Store:
    """One for all tasks of a Dask worker: what it has read of merged files it keeps."""
    return Store.at(where)


@contextmanager
def connected(scheduler: str | None, description: Path | None) -> Iterator[Any]:
    """A client of a running scheduler, or of a cluster that is started for this campaign.

    Parameters
    ----------
    scheduler : str, optional
        Its address, tcp://host:8786.
    description : Path, optional
        A TOML file with `class`, `arguments` and `workers` of a Dask cluster.

    Yields
    ------
    distributed.Client

    Raises
    ------
    InvalidInput
        Dask is not installed, nobody answers, or the cluster cannot be made.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InvalidInput(
            "a cluster needs Dask, which is not installed",
            remedy='pip install "strainwave[cluster]"',
        ) from error
    _silence()
    cluster = None if description is None else _started(description)
    try:
        try:
            client = Client(cluster or scheduler, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"no Dask scheduler answers there ({' '.join(str(error).split())})",
                where=scheduler,
                remedy="start one by `dask scheduler`, or check the address",
            ) from error
        try:
            yield client
        finally:
            with suppress(Exception):  # of a scheduler that has gone
                client.close(timeout=1.0)
    finally:
        if cluster is not None:
            with suppress(Exception):
                cluster.close()


def _silence() -> None:
    """What Dask logs of a scheduler that has gone, one sentence says."""
    for name in list(logging.root.manager.loggerDict):
        if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


@dataclass(frozen=True)
class _Planned:
    """A case's task, since when it may have been recorded."""

    task: Task
    since: datetime


def run(
    cases: Iterable[Case], plan: Plan, client: Any, limits: Limits, workers: int | None = None
) -> Generator[Outcome]:
    """Run cases on the workers of a scheduler.

    Parameters
    ----------
    cases : iterable of Case
    plan : Plan
    client : distributed.Client
    limits : Limits
    workers : int, optional
        Most tasks at a time; without, as many as the cluster has threads.

    Yields
    ------
    Outcome
        As they come.

    Raises
    ------
    ClusterLost
        The scheduler has gone.
    InvalidInput
        The workers cannot run strainwave, or a case cannot be looked for at all.
    """
    waiting: Iterator[Case] | None = iter(cases)
    events: queue.SimpleQueue[Any] = queue.SimpleQueue()
    flying: dict[str, tuple[_Planned, Any]] = {}
    planning = 0
    room = _Room(client, workers)
    pool = ThreadPoolExecutor(_PLANNERS)
    try:
        while True:
            while waiting is not None and planning + len(flying) < room.tasks():
                case = next(waiting, None)
                if case is None:
                    waiting = None
                    break
                planning += 1
                pool.submit(_plan, plan, case).add_done_callback(events.put)
            if not planning and not flying:
                return
            try:
                event = events.get(timeout=_POLL)
            except queue.Empty:
                room.check()
                continue
            if getattr(event, "key", None) is None:  # a case was planned
                planning -= 1
                planned = event.result()
                if isinstance(planned, Outcome):
                    yield planned
                else:
                    future = _submit(client, planned, limits)
                    flying[future.key] = planned, future
                    future.add_done_callback(events.put)
            else:
                planned, future = flying.pop(event.key)
                yield _outcome(planned, future, plan)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _plan(plan: Plan, case: Case) -> _Planned | Outcome:
    since = now()
    task = plan.next(case)
    return task if isinstance(task, Outcome) else _Planned(task, since)


def _submit(client: Any, planned: _Planned, limits: Limits) -> Any:
    with _answered(client):
        return client.submit(
            perform,
            planned.task.to_json(),
            asdict(limits),
            planned.since.isoformat(),
            pure=False,
            key=f"strainwave-{planned.task.run}-{planned.since.timestamp():f}",
        )


@contextmanager
def _answered(client: Any) -> Iterator[None]:
    """A call that needs the scheduler, which may go before it answers."""
    try:
        yield
    except Exception as error:  # a broken connection is an OSError, a closed client is not
        if isinstance(error, OSError | CancelledError) or client.status == "closed":
            raise ClusterLost from error
        raise


def _outcome(planned: _Planned, future: Any, plan: Plan) -> Outcome:
    """What a Dask task came to; one whose workers died again and again is a run that failed."""
    from distributed import KilledWorker

    if future.status == "finished":
        with _answered(future.client):
            return Outcome.from_json(future.result())
    if future.status != "error":
        raise ClusterLost
    error = future.exception()
    if isinstance(error, KilledWorker):
        message = f"the Dask workers that ran it died, {error.allowed_failures + 1} in a row"
        return failed(planned.task, message, exit_code=1, started=planned.since, store=plan.store)
    if isinstance(error, InvalidInput):
        raise error
    raise InvalidInput(
        f"the Dask workers cannot run strainwave ({type(error).__name__}: {error})",
        remedy="install the same version of strainwave where the workers run",
    )


class _Room:
    """How many tasks to have at the scheduler, and whether it is still there."""

    def __init__(self, client: Any, workers: int | None) -> None:
        self._client = client
        self._workers = workers
        self._known, self._looked = _LEAST_AHEAD, -_POLL
        self._seen = time.monotonic()

    def tasks(self) -> int:
        """Those asked for, or so many that no thread of the cluster waits."""
        if self._workers is not None:
            return self._workers
        if time.monotonic() - self._looked > _POLL:
            with suppress(OSError, TimeoutError):
                threads = sum(self._client.nthreads().values())
                self._known = max(_LEAST_AHEAD, (1 + _AHEAD) * threads)
            self._looked = time.monotonic()
        return self._known

    def check(self) -> None:
        """Raise `ClusterLost` where the scheduler has been away too long."""
        if self._client.status == "running":
            self._seen = time.monotonic()
        elif self._client.status == "closed" or time.monotonic() - self._seen > _MISSING:
            raise ClusterLost


def _started(path: Path) -> Any:
    """The cluster that a file describes."""
    text = decode(read_bytes(path, "the cluster's description"), path)
    document = parsed_toml(text, path)
    check_keys(document, _KEYS, path)
    wanted = {"class": str, "arguments": dict, "workers": int}
    given: dict[str, Any] = {"arguments": {}, "workers": 0} | document
    for key, kind in wanted.items():
        if not isinstance(given.get(key), kind):
            raise InvalidInput(
                f"'{key}' is missing or of another type",
                where=str(path),
                remedy='give class = "dask_jobqueue.SLURMCluster", arguments = {...}, workers = 10',
            )
    module, _, name = given["class"].rpartition(".")
    try:
        cluster = getattr(importlib.import_module(module), name)(**given["arguments"])
        if given["workers"]:
            cluster.scale(given["workers"])
    except Exception as error:  # whatever a class from elsewhere says to its arguments
        raise InvalidInput(
            f"{given['class']} cannot be made ({type(error).__name__}: {error})",
            where=str(path),
            remedy="check the class, its package and its arguments",
        ) from error
    return cluster
