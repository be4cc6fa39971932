"""A process that identifies one case after another: `python -m strainwave.campaign.worker`.

It reads a task a line on standard input, and answers each with a line when it begins and a line
when the run stands in the store, which it writes itself. Where its parent ends, so does it, after
the task that it is at.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from strainwave import __version__
from strainwave.campaign.rows import failure_of, now, record_of
from strainwave.campaign.store import Record, Store
from strainwave.campaign.tasks import Outcome, Task
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure

Perform = Callable[[Task], Record]

_GRACE = 30.0  # [s] beyond the time limit, after which a run without a parent ends


def perform(task: Task) -> Record:
    """Identify a case; whatever becomes of it is a record.

    Parameters
    ----------
    task : Task

    Returns
    -------
    Record
        Failed, with exit code 2, where the input is at fault, and with 1 after any other error.
    """
    from strainwave import pipeline

    started, begin = now(), time.perf_counter()
    classes: Mapping[str, Any] = {}

    def failed(message: str, exit_code: int, status: str = "failed") -> Record:
        return failure_of(
            task,
            message,
            exit_code=exit_code,
            started=started,
            seconds=time.perf_counter() - begin,
            status=status,
            classes=classes,
        )

    try:
        _check_version(task)
        with task.case.opened() as opened:
            classes = opened.classes
            found = pipeline.identify(
                opened.study,
                data=opened.data,
                stages=task.stages,
                options=task.options or None,
                threads=1,
            )
            seconds = time.perf_counter() - begin
            return record_of(task, opened, found, started=started, seconds=seconds)
    except InvalidInput as error:
        return failed(str(error), 2)
    except (NotIdentifiable, NumericalFailure) as error:
        return failed(str(error), 3, "not-determined")
    except MemoryError:
        return failed("the run needs more memory than it may take", 1)
    except Exception as error:  # a bug is this study's failure, and not the campaign's
        return failed(_sentence(error), 1)


def _check_version(task: Task) -> None:
    if task.version != __version__:
        raise InvalidInput(
            f"the worker has strainwave {__version__} and the campaign {task.version}",
            remedy="install the same version where the workers run",
        )


def _sentence(error: Exception) -> str:
    """An error on one line, with the place where it was raised."""
    at, last = "", error.__traceback__
    while last is not None:
        at = f"{os.path.basename(last.tb_frame.f_code.co_filename)}:{last.tb_lineno}"
        last = last.tb_next
    return " ".join(f"{type(error).__name__} at {at}: {error}".split())


def answer(task: Task, do: Perform = perform) -> Outcome:
    """Do a task, and write what it leaves.

    Parameters
    ----------
    task : Task
    do : callable
        Task to record.

    Returns
    -------
    Outcome
        `unrecorded` says why the store does not have it.
    """
    record = do(task)
    unrecorded = ""
    try:
        Store.at(task.store).write(record)
    except OSError as error:
        unrecorded = error.strerror or str(error)
    row = record.row
    return Outcome(
        run=record.run,
        study=task.case.name,
        status=row["status"],
        exit_code=row["exit_code"],
        message=row["message"],
        seconds=row["seconds"],
        unrecorded=unrecorded,
    )


def serve(tasks: TextIO, answers: TextIO, time_limit: float, do: Perform = perform) -> None:
    """Do the tasks of a stream until it ends.

    Parameters
    ----------
    tasks, answers : text streams
        A line of JSON each.
    time_limit : float
        [s] after which the parent ends a run; some time later this process does so by itself.
    do : callable
        Task to record.
    """
    for line in tasks:
        task = Task.from_json(line)
        _say(answers, json.dumps({"begun": task.run}))
        faulthandler.dump_traceback_later(time_limit + _GRACE, exit=True)
        outcome = answer(task, do)
        faulthandler.cancel_dump_traceback_later()
        _say(answers, json.dumps({"resident_mib": _resident_mib()} | json.loads(outcome.to_json())))


def _say(answers: TextIO, line: str) -> None:
    answers.write(line + "\n")
    answers.flush()


def _resident_mib() -> float:
    """Memory that this process holds."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except OSError:  # no /proc: the most it has held
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def main(do: Perform = perform) -> None:
    """Serve standard input and output; what else is printed goes to standard error.

    Parameters
    ----------
    do : callable
        Task to record.
    """
    parser = argparse.ArgumentParser(prog="strainwave.campaign.worker")
    parser.add_argument("--time-limit", type=float, required=True)
    parser.add_argument("--memory-limit", type=int, metavar="MIB")
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    faulthandler.enable()

    from strainwave.numerics.parallel import own_process

    own_process()
    from strainwave import pipeline  # noqa: F401 - before the first task's time begins

    if given.memory_limit is not None:
        most = given.memory_limit * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        serve(sys.stdin, answers, given.time_limit, do)
    except BrokenPipeError:  # the parent has ended, and the run is recorded
        os._exit(0)


if __name__ == "__main__":
    main()
