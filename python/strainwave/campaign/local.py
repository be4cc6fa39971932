"""A campaign on this machine, with one worker process per slot."""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed

from strainwave.campaign.runner import Plan, Runner
from strainwave.campaign.study_files import Case
from strainwave.campaign.tasks import Limits, Outcome


def run(
    cases: Iterable[Case],
    plan: Plan,
    workers: int,
    limits: Limits,
    start: Callable[[Limits], Runner] = Runner,
) -> Generator[Outcome]:
    """Run cases in `workers` processes, which `start` creates; yield outcomes as they come.

    If the caller closes the generator, the processes are killed and their runs are not recorded.
    Raises `InvalidInput` if the worker processes do not start or a case cannot be read at all.
    """
    runners = [start(limits) for _ in range(workers)]
    idle: queue.SimpleQueue[Runner] = queue.SimpleQueue()
    for runner in runners:
        idle.put(runner)

    def outcome_of(case: Case) -> Outcome:
        task = plan.next(case)
        if isinstance(task, Outcome):
            return task
        runner = idle.get()
        try:
            return runner.run(task)
        finally:
            idle.put(runner)

    pool = ThreadPoolExecutor(workers)
    try:
        for future in as_completed([pool.submit(outcome_of, case) for case in cases]):
            yield future.result()
        for runner in runners:
            runner.close()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for runner in runners:
            runner.stop()
        for runner in runners:
            runner.close()
