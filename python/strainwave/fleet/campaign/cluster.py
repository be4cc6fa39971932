"""A campaign on a Dask cluster: each thread of a Dask worker has one worker process.

Tasks and outcomes are sent as one line of JSON each. Studies and store must be reachable by path or
URL from every worker.
"""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput
from strainwave.fleet.campaign.records import FAILED_STATUS, Outcome, RunLimits, Task, now
from strainwave.fleet.campaign.runner import CampaignPlan, Runner, failed
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import Case
from strainwave.io.atomic_files import check_keys, decode, parse_toml, read_bytes
from strainwave.numerics import dask_cluster
from strainwave.numerics.dask_cluster import ClusterLost, connected_call, load_client

_POLL_S = 0.05  # between two checks for ended tasks
_N_PLANNERS = 4  # threads that check which runs are recorded
_KEYS = ("class", "arguments", "workers")

_Planned = tuple[Task, datetime]
"""A task, and the time since when it may have been recorded."""

_thread = threading.local()


def perform(line: str, limits: dict[str, Any], since: str) -> str:
    """Perform one task in the worker process of this thread, on a Dask worker.

    `line` is a `Task`, `limits` the fields of `RunLimits`; returns an `Outcome`, both as JSON. A
    run recorded after `since`, the ISO 8601 time of planning, is that of this task: its Dask worker
    died after its worker process had recorded it.
    """
    task = Task.from_json(line)
    recorded = Store(task.store).recorded(task.run)
    if recorded and (
        recorded.status != FAILED_STATUS or recorded.started >= datetime.fromisoformat(since)
    ):
        return recorded.to_json()
    if getattr(_thread, "limits", None) != limits:
        _thread.limits, _thread.runner = limits, Runner(RunLimits(**limits))
    runner: Runner = _thread.runner
    return runner.run(task).to_json()


@contextmanager
def connected(scheduler: str | None, description: Path | None) -> Iterator[Any]:
    """A client of a running scheduler, or of a cluster that is started for this campaign.

    `scheduler` is an address such as tcp://host:8786, `description` a TOML file with `class`,
    `arguments` and `workers`. Raises `InvalidInput` if Dask is not installed, the scheduler does
    not answer, or the cluster cannot be created.
    """
    load_client()  # Dask, before the description
    cluster = None if description is None else _started(description)
    try:
        with dask_cluster.connected(cluster or scheduler) as client:
            yield client
    finally:
        if cluster is not None:
            with suppress(Exception):
                cluster.close()


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
    from distributed import as_completed

    submitted: dict[str, _Planned] = {}
    ended = as_completed(loop=client.loop)
    pool = ThreadPoolExecutor(_N_PLANNERS)
    try:
        for task, since in pool.map(lambda case: _plan(plan, case), cases):
            if isinstance(task, Outcome):
                yield task
                continue
            future = _submit(client, (task, since), limits)
            submitted[future.key] = task, since
            ended.add(future)
            is_full = workers is not None and len(submitted) >= workers
            for each in _next_batch(ended, client, wait=is_full):
                yield _outcome(submitted.pop(each.key), each, plan)
        while submitted:
            for each in _next_batch(ended, client, wait=True):
                yield _outcome(submitted.pop(each.key), each, plan)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _plan(plan: CampaignPlan, case: Case) -> tuple[Task | Outcome, datetime]:
    since = now()
    return plan.next(case), since


def _submit(client: Any, planned: _Planned, limits: RunLimits) -> Any:
    task, since = planned
    key = f"strainwave-{task.run}-{since.timestamp():f}"
    work = perform, task.to_json(), asdict(limits), since.isoformat()
    with connected_call(client):
        return client.submit(*work, pure=False, key=key)


def _next_batch(ended: Any, client: Any, *, wait: bool) -> list[Any]:
    """Futures that have ended, at least one with `wait`."""
    while wait and not ended.has_ready():
        if client.status == "closed":  # after it has tried to reconnect
            raise ClusterLost
        time.sleep(_POLL_S)
    return list(ended.next_batch(block=False))


def _outcome(planned: _Planned, future: Any, plan: CampaignPlan) -> Outcome:
    """Outcome of a Dask task; a task whose workers died repeatedly is a failed run.

    Waits again if the worker that holds the outcome has died meanwhile.
    """
    from distributed import KilledWorker

    with connected_call(future.client):
        error = future.exception()
        if error is None:
            return Outcome.from_json(future.result())
    if isinstance(error, KilledWorker):
        message = f"the Dask workers that ran it died, {error.allowed_failures + 1} in a row"
        task, since = planned
        return failed(task, message, exit_code=1, started=since, store=plan.store)
    if isinstance(error, InvalidInput):
        raise error
    raise InvalidInput(
        f"the Dask workers cannot run strainwave ({type(error).__name__}: {error})",
        remedy="install the same version of strainwave where the workers run",
    )


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
