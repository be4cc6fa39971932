"""A process that identifies one case after another: `python -m strainwave.fleet.campaign.worker`.

It reads one task per line from standard input. It answers with one line when a task starts and one
when the run is in the store, which it writes itself. If the parent ends, the worker ends after the
present task.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.fleet.campaign.records import (
    FAILED_STATUS,
    Outcome,
    RunRecord,
    Task,
    failure_of,
    now,
    record_of,
)
from strainwave.fleet.campaign.store import Store
from strainwave.io.system import limit_memory, resident_mib
from strainwave.version import __version__

Perform = Callable[[Task], RunRecord]

_ORPHAN_GRACE_S = 30.0  # [s] beyond the time limit before a run without a parent ends


def perform(task: Task) -> RunRecord:
    """Identify a case; every outcome is a record.

    Exit code 2 if the input is invalid, 1 after any other error.
    """
    from strainwave import pipeline

    started = now()
    classes: Mapping[str, Any] = {}

    status = FAILED_STATUS
    try:
        if task.version != __version__:
            raise InvalidInput(
                f"the worker has strainwave {__version__}, the campaign {task.version}",
                remedy="install the same version where the workers run",
            )
        with task.case.opened() as opened:
            classes = opened.classes
            identification = pipeline.identify(
                opened.study,
                data=opened.data,
                stages=task.stages,
                options=task.options or None,
                threads=1,
            )
            return record_of(task, opened, identification, started=started)
    except InvalidInput as error:
        message, code = str(error), 2
    except (NotIdentifiable, NumericalFailure) as error:
        message, code, status = str(error), 3, "not-determined"
    except MemoryError:
        message, code = "the run needs more memory than its limit", 1
    except Exception as error:  # a bug fails this study, not the campaign
        message, code = _sentence(error), 1
    return failure_of(
        task, message, exit_code=code, started=started, status=status, classes=classes
    )


def _sentence(error: Exception) -> str:
    """An error on one line with file and line of its origin."""
    at, last = "", error.__traceback__
    while last is not None:
        at = f"{os.path.basename(last.tb_frame.f_code.co_filename)}:{last.tb_lineno}"
        last = last.tb_next
    return " ".join(f"{type(error).__name__} at {at}: {error}".split())


def answer(task: Task, do: Perform = perform) -> Outcome:
    """Perform a task by `do` and write its record to the store."""
    record = do(task)
    return Outcome.of(record.row, unrecorded=Store(task.store).try_write(record))


def serve(tasks: TextIO, answers: TextIO, time_limit: float, do: Perform) -> None:
    """Perform the tasks of a stream, one JSON line each, until it ends.

    The parent kills a run after `time_limit` [s]; without a parent this process ends itself later.
    """
    for line in tasks:
        task = Task.from_json(line)
        _send(answers, {"started": task.run})
        faulthandler.dump_traceback_later(time_limit + _ORPHAN_GRACE_S, exit=True)
        outcome = answer(task, do)
        faulthandler.cancel_dump_traceback_later()
        _send(answers, {"resident_mib": resident_mib(), "outcome": outcome.to_json()})


def _send(answers: TextIO, message: Mapping[str, Any]) -> None:
    answers.write(json.dumps(message) + "\n")
    answers.flush()


def main(do: Perform = perform) -> None:
    """Serve standard input and output; other output goes to standard error."""
    parser = argparse.ArgumentParser(prog="strainwave.fleet.campaign.worker")
    parser.add_argument("--time-limit", type=float, required=True)
    parser.add_argument("--memory-limit", type=int, metavar="MIB")
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    faulthandler.enable()

    from strainwave.numerics.parallel import configure_process

    configure_process()
    from strainwave import pipeline  # noqa: F401 - before the time of the first task

    if arguments.memory_limit is not None:
        limit_memory(arguments.memory_limit)
    try:
        serve(sys.stdin, answers, arguments.time_limit, do)
    except BrokenPipeError:  # the parent has ended; the run is recorded
        os._exit(0)


if __name__ == "__main__":
    main()
