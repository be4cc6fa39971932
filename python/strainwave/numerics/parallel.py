"""The computer's cores: one for many small systems, all of them for work that is independent."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar, cast

Result = TypeVar("Result")
First = TypeVar("First")
Second = TypeVar("Second")

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_KEPT = 2**28  # bytes
_NEW_OBJECTS = 100_000  # from one look of the collector to the next
_THREAD_TURN = 1e-3  # [s] after which a thread gives way to one that returns from compiled code


def one_blas_thread() -> AbstractContextManager[object]:
    """Limit BLAS to one thread: in small products, synchronisation costs more than it saves."""
    from threadpoolctl import threadpool_limits

    limit: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limit


def own_process() -> None:
    """Make ready a process that is all ours, for as long as it lasts; before NumPy is imported.

    OpenBLAS begins no threads: they would wait for work in a loop, on a core that has some. The
    collector of cycles, of which there are few, looks rarely, and at the end not at all. And the
    memory that is freed is kept.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # to find none takes a while
    gc.set_threshold(_NEW_OBJECTS)
    sys.setswitchinterval(_THREAD_TURN)
    atexit.register(gc.freeze)
    _keep_memory()


def _keep_memory() -> None:
    """Let the process keep what it frees, where its C library is glibc.

    Otherwise each array of some size is new to it, and the kernel clears it page by page: an eighth
    of a run's time.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    for option in (_MMAP_THRESHOLD, _TRIM_THRESHOLD):
        mallopt(option, _KEPT)


class Stopped(BaseException):
    """Work that nobody waits for any more: a job beside it failed, or the user asked for the end.

    No error, so that nothing which handles errors takes it for one.
    """


class _Group:
    """Jobs that end together, as part of a job of another group or of none."""

    def __init__(
        self,
        parent: _Group | None,
        threads: int | None,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        self.parent = parent
        self.threads = threads  # None: as many as there are cores
        self.cancelled = cancelled
        self.stopped = False

    def is_stopped(self) -> bool:
        if self.cancelled is not None and self.cancelled():
            self.stopped = True
        return self.stopped or (self.parent is not None and self.parent.is_stopped())


_thread = threading.local()


def _group() -> _Group | None:
    """The group whose job this thread does."""
    group: _Group | None = getattr(_thread, "group", None)
    return group


@contextmanager
def limited(
    threads: int | None = None, cancelled: Callable[[], bool] | None = None
) -> Iterator[None]:
    """Limit the threads of all `side_by_side` in this block, and let somebody else end it.

    `threads`: At most so many work at a time, those of jobs within jobs included. None: a thread
        per core in each `side_by_side`.
    `cancelled`: Asked at every `stop_if_asked` whether the work is still wanted.

    Raises `Stopped`: it is not wanted any more.
    """
    before = _group()
    _thread.group = _Group(before, threads, cancelled)
    try:
        yield
    finally:
        _thread.group = before


def stop_if_asked() -> None:
    """End here where nobody waits for this job's result any more; long loops call it every round.

    Raises `Stopped`: A job of the same `side_by_side` failed, its caller was interrupted, or the
    work is cancelled.
    """
    group = _group()
    if group is not None and group.is_stopped():
        raise Stopped


def side_by_side(jobs: Sequence[Callable[[], Result]]) -> list[Result]:
    """Do independent jobs on all cores, or on as many as `limited` allows.

    Threads, because NumPy and the core let go of the interpreter while they work. None of them
    outlives the call: where a job fails or the caller is interrupted, those that wait never begin,
    and those that run end at their next `stop_if_asked`.

    Returns: Their results, in order. The first exception among them is raised.
    """
    parent = _group()
    allowed = None if parent is None else parent.threads
    if len(jobs) <= 1 or allowed == 1:  # a thread costs as much as a small job
        return [_one_after_another(job) for job in jobs]
    workers = os.cpu_count() if allowed is None else min(allowed, len(jobs))
    inside = None if allowed is None else max(1, allowed // min(allowed, len(jobs)))
    group = _Group(parent, inside)
    pool = ThreadPoolExecutor(workers)
    try:
        results = [pool.submit(_in_group, group, job) for job in jobs]
        return [each.result() for each in results]
    finally:
        group.stopped = True
        pool.shutdown(wait=True, cancel_futures=True)


def both(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """Two jobs by `side_by_side`, and their results."""
    jobs: list[Callable[[], First | Second]] = [first, second]
    one, other = side_by_side(jobs)
    return cast("First", one), cast("Second", other)


def _one_after_another(job: Callable[[], Result]) -> Result:
    stop_if_asked()
    return job()


def _in_group(group: _Group, job: Callable[[], Result]) -> Result:
    _thread.group = group
    stop_if_asked()
    return job()
