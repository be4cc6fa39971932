"""A campaign on this machine: as many worker processes as there are slots."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterable

from strainwave.campaign.cases import Case
from strainwave.campaign.plan import Plan
from strainwave.campaign.runner import Runner, Stopping
from strainwave.campaign.tasks import Limits, Outcome

_GRACE = 0.5  # [s] for a slot to clear up after its process has been ended


def run(
    cases: Iterable[Case],
    plan: Plan,
    workers: int,
    limits: Limits,
    start: Callable[[Limits], Runner] = Runner,
) -> Generator[Outcome]:
    """Run cases, each in one of the worker processes.

    Where the caller leaves, the processes are ended and what they were at is not recorded.

    Parameters
    ----------
    cases : iterable of Case
    plan : Plan
    workers : int
        Processes at a time.
    limits : Limits
    start : callable
        Makes a runner.

    Yields
    ------
    Outcome
        As they come.

    Raises
    ------
    InvalidInput
        The worker processes do not start, or a case cannot be looked for at all.
    """
    waiting, mutex = iter(cases), threading.Lock()
    ended: queue.SimpleQueue[Outcome | BaseException | None] = queue.SimpleQueue()
    runners = [start(limits) for _ in range(workers)]
    left = threading.Event()

    def slot(runner: Runner) -> None:
        try:
            while not left.is_set():
                with mutex:
                    case = next(waiting, None)
                if case is None:
                    break
                task = plan.next(case)
                ended.put(task if isinstance(task, Outcome) else runner.run(task))
            runner.close()
        except Stopping:
            runner.close()
        except BaseException as error:  # raised again where outcomes are waited for
            ended.put(error)
        finally:
            ended.put(None)

    threads = [threading.Thread(target=slot, args=(each,), daemon=True) for each in runners]
    for thread in threads:
        thread.start()
    try:
        busy = workers
        while busy:
            outcome = ended.get()
            if outcome is None:
                busy -= 1
            elif isinstance(outcome, BaseException):
                raise outcome
            else:
                yield outcome
    finally:
        left.set()
        for runner in runners:
            runner.stop()
        for thread in threads:
            thread.join(_GRACE)
