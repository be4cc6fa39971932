"""A campaign on a Dask cluster: each thread of a Dask worker has one worker process.

Tasks and outcomes are sent as one line of JSON each. Studies and store must be reachable by path or
URL from every worker.
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
from dataclasses import asdict
from datetime import datetime
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from strainwave.errors import InvalidInput, StrainwaveError, import_optional
from strainwave.fleet.campaign.records import FAILED_STATUS, Outcome, RunLimits, Task, now
from strainwave.fleet.campaign.runner import CampaignPlan, Runner, failed
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import Case
from strainwave.io.atomic_files import check_keys, decode, parse_toml, read_bytes

_CONNECT_TIMEOUT_S = 10.0  # of the scheduler
_POLL_S = 0.5  # between two checks of the scheduler
_MAX_ABSENCE_S = 10.0  # of the scheduler before the campaign ends
_QUEUED_PER_THREAD = 2  # tasks that wait at the scheduler, so that no thread idles
_MIN_QUEUED = 16  # for clusters that still start
_N_PLANNERS = 4  # threads that check which runs are recorded
_KEYS = ("class", "arguments", "workers")

_thread = threading.local()


class ClusterLost(StrainwaveError):  # noqa: N818
    """The scheduler is lost; the same command continues where this one ended."""

    def __init__(self) -> None:
        super().__init__("the Dask scheduler is lost")


def perform(line: str, limits: dict[str, Any], since: str) -> str:
    """Perform one task in the worker process of this thread, on a Dask worker.

    `line` is a `Task`, `limits` the fields of `RunLimits`; returns an `Outcome`, both as JSON. A
    run recorded after `since`, the ISO 8601 time of planning, is that of this task: its Dask worker
    died after its worker process had recorded it.
    """
    task = Task.from_json(line)
    recorded = _store(task.store).recorded(task.run)
    if recorded and (
        recorded.status != FAILED_STATUS or recorded.started >= datetime.fromisoformat(since)
    ):
        return recorded.to_json()
    if getattr(_thread, "limits", None) != limits:
        _thread.limits, _thread.runner = limits, Runner(RunLimits(**limits))
    runner: Runner = _thread.runner
    return runner.run(task).to_json()


@cache
def _store(where: str) -> Store:
    """One store for all tasks of a Dask worker, which caches merged files."""
    return Store.at(where)


@contextmanager
def connected(scheduler: str | None, description: Path | None) -> Iterator[Any]:
    """A client of a running scheduler, or of a cluster that is started for this campaign.

    `scheduler` is an address such as tcp://host:8786, `description` a TOML file with `class`,
    `arguments` and `workers`. Raises `InvalidInput` if Dask is not installed, the scheduler does
    not answer, or the cluster cannot be created.
    """
    Client = import_optional("distributed", "a cluster", '"strainwave[cluster]"').Client
    for name in list(logging.root.manager.loggerDict):  # `ClusterLost` reports a lost scheduler
        if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    cluster = None if description is None else _started(description)
    try:
        try:
            client = Client(cluster or scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"no Dask scheduler answers ({' '.join(str(error).split())})",
                where=scheduler,
                remedy="start one by `dask scheduler`, or check the address",
            ) from error
        try:
            yield client
        finally:
            with suppress(Exception):  # a lost scheduler does not answer
                client.close(timeout=1.0)
    finally:
        if cluster is not None:
            with suppress(Exception):
                cluster.close()


class _PlannedTask(NamedTuple):
    """A task and the time since when it may have been recorded."""

    task: Task
    since: datetime


def run(
    cases: Iterable[Case],
    plan: CampaignPlan,
    client: Any,
    limits: RunLimits,
    workers: int | None = None,
) -> Generator[Outcome]:
    """Run cases on the workers of a scheduler; yield outcomes as they come.

    `workers` limits the number of submitted tasks. Raises `ClusterLost` if the scheduler is lost,
    and `InvalidInput` if the workers cannot run strainwave or a case cannot be read at all.
    """
    waiting = iter(cases)
    events: queue.SimpleQueue[Any] = queue.SimpleQueue()
    submitted: dict[str, tuple[_PlannedTask, Any]] = {}
    planning = 0
    capacity = _Capacity(client, workers)
    pool = ThreadPoolExecutor(_N_PLANNERS)
    try:
        while True:
            free = max(0, capacity.tasks() - planning - len(submitted))
            for case in islice(waiting, free):
                planning += 1
                pool.submit(_plan, plan, case).add_done_callback(events.put)
            if not planning and not submitted:
                return
            try:
                event = events.get(timeout=_POLL_S)
            except queue.Empty:
                capacity.check()
                continue
            if getattr(event, "key", None) is None:  # a case was planned
                planning -= 1
                planned = event.result()
                if isinstance(planned, Outcome):
                    yield planned
                else:
                    future = _submit(client, planned, limits)
                    submitted[future.key] = planned, future
                    future.add_done_callback(events.put)
            else:
                planned, future = submitted.pop(event.key)
                yield _outcome(planned, future, plan)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _plan(plan: CampaignPlan, case: Case) -> _PlannedTask | Outcome:
    since = now()
    task = plan.next(case)
    return task if isinstance(task, Outcome) else _PlannedTask(task, since)


def _submit(client: Any, planned: _PlannedTask, limits: RunLimits) -> Any:
    task, since = planned
    key = f"strainwave-{task.run}-{since.timestamp():f}"
    work = perform, task.to_json(), asdict(limits), since.isoformat()
    with _connected_call(client):
        return client.submit(*work, pure=False, key=key)


@contextmanager
def _connected_call(client: Any) -> Iterator[None]:
    """A call of the scheduler, which may be lost during the call."""
    try:
        yield
    except Exception as error:  # a broken connection is an OSError, a closed client is not
        if isinstance(error, OSError | CancelledError) or client.status == "closed":
            raise ClusterLost from error
        raise


def _outcome(planned: _PlannedTask, future: Any, plan: CampaignPlan) -> Outcome:
    """Outcome of a Dask task; a task whose workers died repeatedly is a failed run."""
    from distributed import KilledWorker

    if future.status == "finished":
        with _connected_call(future.client):
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


class _Capacity:
    """Number of tasks to submit, and check of the scheduler."""

    def __init__(self, client: Any, workers: int | None) -> None:
        self._client = client
        self._workers = workers
        self._n_tasks, self._checked = _MIN_QUEUED, -_POLL_S
        self._last_contact = time.monotonic()

    def tasks(self) -> int:
        """The number of workers, or enough tasks for all threads of the cluster."""
        if self._workers is not None:
            return self._workers
        if time.monotonic() - self._checked > _POLL_S:
            with suppress(OSError, TimeoutError):
                threads = sum(self._client.nthreads().values())
                self._n_tasks = max(_MIN_QUEUED, (1 + _QUEUED_PER_THREAD) * threads)
            self._checked = time.monotonic()
        return self._n_tasks

    def check(self) -> None:
        """Raise `ClusterLost` if the scheduler does not answer for too long."""
        if self._client.status == "running":
            self._last_contact = time.monotonic()
        elif (
            self._client.status == "closed"
            or time.monotonic() - self._last_contact > _MAX_ABSENCE_S
        ):
            raise ClusterLost


def _started(path: Path) -> Any:
    document = parse_toml(decode(read_bytes(path, "the cluster's description"), path), path)
    check_keys(document, _KEYS, path)
    types = {"class": str, "arguments": dict, "workers": int}
    values: dict[str, Any] = {"arguments": {}, "workers": 0} | document
    for key, kind in types.items():
        if not isinstance(values.get(key), kind):
            raise InvalidInput(
                f"'{key}' is missing or has the wrong type",
                where=str(path),
                remedy='give class = "dask_jobqueue.SLURMCluster", arguments = {...}, workers = 10',
            )
    module, _, name = values["class"].rpartition(".")
    try:
        cluster = getattr(importlib.import_module(module), name)(**values["arguments"])
        if values["workers"]:
            cluster.scale(values["workers"])
    except Exception as error:  # a foreign class may raise anything
        raise InvalidInput(
            f"{values['class']} cannot be created ({type(error).__name__}: {error})",
            where=str(path),
            remedy="check the class, its package and its arguments",
        ) from error
    return cluster
