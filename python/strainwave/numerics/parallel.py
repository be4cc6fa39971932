"""Parallel execution of independent jobs, and settings of a process for the command line."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

    from strainwave.numerics.dask_cluster import Cluster

Result = TypeVar("Result")
First = TypeVar("First")
Second = TypeVar("Second")

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # options of mallopt in glibc's malloc.h
_KEPT_BYTES = 2**28  # bytes below which freed memory is kept and arrays are not mapped separately
_COLLECTOR_THRESHOLD = 100_000  # allocations between two runs of the garbage collector
# [s] maximum time before a thread releases the interpreter to another thread
_SWITCH_INTERVAL = 1e-3


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread: for small products, synchronisation costs more than it saves."""
    with _blas_libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
        yield


@cache
def _blas_libraries(with_scipy: bool) -> ThreadpoolController:  # SciPy has another
    """Loaded BLAS libraries; the search for them takes as long as a small fit."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def configure_worker() -> None:
    """Configure a process that runs other code as well: one BLAS thread, and memory is kept.

    The limit holds until the process ends, because its threads share it.
    """
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1, user_api="blas")
    _keep_freed_memory()


def configure_process() -> None:
    """Configure a process that runs only this package; call it before NumPy is imported.

    OpenBLAS starts no threads, because idle BLAS threads busy-wait on the cores. The garbage
    collector runs rarely, because few reference cycles occur, and not at exit. Freed memory is
    kept.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # searching for plugins takes time
    gc.set_threshold(_COLLECTOR_THRESHOLD)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    atexit.register(gc.freeze)
    _keep_freed_memory()


def _keep_freed_memory() -> None:
    # otherwise the kernel clears the pages of each new large array, an eighth of a run's time
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library than glibc
        return
    for option in (_MMAP_THRESHOLD, _TRIM_THRESHOLD):
        mallopt(option, _KEPT_BYTES)
    mallopt(_ARENA_MAX, os.cpu_count() or 1)  # of eight times as many, each keeps what it freed


class Stopped(BaseException):
    """Signal that a job was cancelled: another job failed, or the user interrupted the work.

    Not an `Exception`, so handlers of errors do not catch it.
    """


class _JobGroup:
    """Jobs that are stopped together; a group may belong to a job of another group."""

    def __init__(
        self,
        parent: _JobGroup | None,
        threads: int | None,
        cancelled: Callable[[], bool] | None = None,
        cluster: Cluster | None = None,
    ) -> None:
        self.parent = parent
        self.cluster: Cluster | None = cluster or (parent.cluster if parent else None)
        self.threads = threads  # None: number of cores
        self.cancelled = cancelled
        self.stopped = False

    def is_stopped(self) -> bool:
        if self.cancelled is not None and self.cancelled():
            self.stopped = True
        return self.stopped or (self.parent is not None and self.parent.is_stopped())


_thread = threading.local()


def _group() -> _JobGroup | None:
    group: _JobGroup | None = getattr(_thread, "group", None)
    return group


@contextmanager
def limited(
    threads: int | None = None,
    cancelled: Callable[[], bool] | None = None,
    cluster: Cluster | None = None,
) -> Iterator[None]:
    """Limit the threads of every `run_parallel` in this block, and allow cancellation.

    `threads`: Maximum number of threads, including those of nested jobs. None: one thread per core
        in each `run_parallel`.
    `cancelled`: Called at every `raise_if_stopped`; True cancels the work.
    `cluster`: Cluster for the jobs that can run on one.

    Raises `Stopped` after cancellation.
    """
    outer_group = _group()
    _thread.group = _JobGroup(outer_group, threads, cancelled, cluster)
    try:
        yield
    finally:
        _thread.group = outer_group


def current_cluster() -> Cluster | None:
    """The cluster for jobs of this thread; None: threads of this process."""
    group = _group()
    return None if group is None else group.cluster


def raise_if_stopped() -> None:
    """Stop the current job if its result is no longer needed.

    Long loops call this function in every iteration. Raises `Stopped` if a job of the same
    `run_parallel` failed, its caller was interrupted, or the work was cancelled.
    """
    group = _group()
    if group is not None and group.is_stopped():
        raise Stopped


def run_parallel(jobs: Sequence[Callable[[], Result]]) -> list[Result]:
    """Run independent jobs on all cores, or on as many threads as `limited` allows.

    Threads suffice, because NumPy and the core release the interpreter lock. No thread outlives the
    call. If a job fails or the caller is interrupted, waiting jobs do not start, and running jobs
    end at their next `raise_if_stopped`.

    Returns the results in the order of the jobs, or raises the first exception.
    """
    parent = _group()
    max_threads = None if parent is None else parent.threads
    if len(jobs) <= 1 or max_threads == 1:  # a thread costs as much as a small job
        return [_run(parent, job) for job in jobs]
    workers = min(max_threads or os.cpu_count() or 1, len(jobs))
    group = _JobGroup(parent, max_threads and max_threads // workers)
    pool = ThreadPoolExecutor(workers)
    try:
        results = [pool.submit(_run, group, job) for job in jobs]
        return [each.result() for each in results]
    finally:
        group.stopped = True
        pool.shutdown(wait=True, cancel_futures=True)


def even_groups(n_jobs: int, largest: int) -> int:
    """Number of groups of at most `largest` jobs that occupy all threads evenly."""
    group = _group()
    threads = (group and group.threads) or os.cpu_count() or 1
    rounds = -(-n_jobs // (largest * threads))
    return min(n_jobs, rounds * threads)


def both(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Results of two jobs run by `run_parallel`."""
    jobs: list[Callable[[], First | Second]] = [first, second]
    first_result, second_result = run_parallel(jobs)
    return cast("First", first_result), cast("Second", second_result)


def _run(group: _JobGroup | None, job: Callable[[], Result]) -> Result:
    _thread.group = group
    raise_if_stopped()
    return job()
