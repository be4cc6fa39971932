"""Parallel jobs, and the configuration of a process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial

import pytest

from strainwave.numerics.parallel import Stopped, raise_if_stopped, run_parallel


def test_results_come_in_order() -> None:
    assert run_parallel([partial(pow, k, 2) for k in range(7)]) == [0, 1, 4, 9, 16, 25, 36]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is but one core")
def test_jobs_run_at_the_same_time() -> None:
    both = threading.Barrier(2, timeout=30.0)

    def meet() -> bool:
        both.wait()  # raises unless the other job arrives
        return True

    assert run_parallel([meet, meet]) == [True, True]


def test_a_job_that_fails_shows_who_asks() -> None:
    def job() -> int:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        run_parallel([lambda: 3, job])


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is but one core")
def test_a_failed_job_stops_the_parallel_jobs() -> None:
    """Nested jobs end too, and waiting jobs do not start."""
    begun = threading.Barrier(3, timeout=30.0)
    ended = list[threading.Thread]()
    late = list[int]()

    def endless() -> None:
        begun.wait()
        try:
            while True:
                raise_if_stopped()
        except Stopped:
            ended.append(threading.current_thread())
            raise

    def fails() -> None:
        begun.wait()
        raise ValueError("no")

    def begins_two() -> None:
        run_parallel([endless, endless])

    jobs: list[Callable[[], object]] = [fails, begins_two, partial(late.append, 1)]
    with pytest.raises(ValueError, match="no"):
        run_parallel(jobs)
    assert len(ended) == 2
    assert not any(thread.is_alive() for thread in ended)
    assert late in ([], [1])  # it may have started before the failure
    raise_if_stopped()  # outside the jobs, nothing is stopped


def test_a_process_of_our_own_begins_no_blas_threads() -> None:
    code = """
from strainwave.numerics.parallel import configure_process
configure_process()
import numpy
from threadpoolctl import threadpool_info
print(*{i["num_threads"] for i in threadpool_info() if i["internal_api"] == "openblas"})
"""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    process = subprocess.run(
        [sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True
    )
    if not process.stdout.strip():
        pytest.skip("this NumPy has another BLAS")
    assert process.stdout.split() == ["1"]
