"""A worker process as its parent sees it: one task at a time, with limits.

The cases that still have to run: those without a recorded run with the same hashes. A campaign on
this machine has one worker process per slot.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from typing import IO, Any

from strainwave.domain import Stage
from strainwave.errors import InvalidInput
from strainwave.fleet.campaign.records import (
    FAILED_STATUS,
    Outcome,
    RunLimits,
    Task,
    failure_of,
    merged,
    now,
    worker_name,
)
from strainwave.fleet.campaign.store import Store
from strainwave.fleet.campaign.study_files import Case
from strainwave.io.system import OWN_GROUP, kill_group

TIMEOUT_EXIT_CODE = 124
"""Exit code of a run that exceeds its time limit, as of the command `timeout`."""
_ENTRY = ("-m", "strainwave.fleet.campaign.worker")
_MAX_RESIDENT_MIB = 1024.0  # of a worker between tasks, without a memory limit
_EXIT_S = 5.0  # [s] for a worker without tasks to end
_TAIL_BYTES = 4096  # of standard error that are searched for the cause of a death
_FATAL_PREFIXES = ("Fatal", "Timeout", "memory allocation")  # of lines that state the cause


class Stopping(Exception):  # noqa: N818
    """The campaign ends; the present run is not recorded."""


class Runner:
    """A worker process, started on demand, reused, and replaced when it dies.

    `entry` are the arguments of Python that start the worker.
    """

    def __init__(self, limits: RunLimits, entry: Sequence[str] = _ENTRY) -> None:
        self._limits = limits
        self._entry = tuple(entry)
        self._child: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._done = 0
        self._stopped = False
        self._mutex = threading.Lock()

    def run(self, task: Task) -> Outcome:
        """Perform a task; a process that dies or exceeds the time limit is a failed run.

        Raises `InvalidInput` if the process does not start, `Stopping` after `stop`.
        """
        started, until = now(), time.perf_counter() + self._limits.time_s
        name = ""
        try:
            child = self._start_task(task, until)
            name = worker_name(child.pid)
            answer = self._line(until)
        except TimeoutError:
            self._end()
            message = f"took longer than {self._limits.time_s:g} s"
            code = TIMEOUT_EXIT_CODE
        except EOFError:
            code, message = self._death()
        else:
            self._done += 1
            limit, resident = self._limits.memory_mib, float(answer["resident_mib"])
            allowed = _MAX_RESIDENT_MIB if limit is None else 0.5 * limit
            if self._done >= self._limits.tasks or resident > allowed:
                self.close()
            return Outcome.from_json(answer["outcome"])
        if self._stopped:
            raise Stopping
        return failed(task, message, exit_code=code, started=started, worker=name)

    def close(self) -> None:
        """Let the process, which has no task, end."""
        child = self._child
        if child is not None and child.stdin is not None:
            with suppress(OSError):
                child.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                child.wait(_EXIT_S)
        self._end()

    def stop(self) -> None:
        """Kill the process, from any thread; `run` raises `Stopping`."""
        with self._mutex:
            self._stopped = True
            if self._child is not None:
                _kill(self._child)

    def _start_task(self, task: Task, until: float) -> subprocess.Popen[bytes]:
        """A process that has started the task; one that has died is replaced once."""
        line = (task.to_json() + "\n").encode()
        for _ in range(2):
            child = self._process()
            with suppress(OSError):  # it has ended
                assert child.stdin is not None
                child.stdin.write(line)
                child.stdin.flush()
            try:
                self._line(until)
            except EOFError:
                if self._stopped:
                    raise
                _, message = self._death()
                continue
            return child
        raise InvalidInput(
            f"the worker process does not start: {message}",
            where=None if self._limits.memory_mib is None else "--memory-limit",
            remedy="allow more memory, or leave the limit out"
            if self._limits.memory_mib is not None
            else "run `python -m strainwave.fleet.campaign.worker --time-limit 60` to see why",
        )

    def _process(self) -> subprocess.Popen[bytes]:
        if self._child is not None and self._child.poll() is None:
            return self._child
        self._end()
        arguments = [*self._entry, "--time-limit", str(self._limits.time_s)]
        if self._limits.memory_mib is not None:
            arguments += ["--memory-limit", str(self._limits.memory_mib)]
        with self._mutex:
            if self._stopped:
                raise Stopping
            # so that the worker imports the same modules as this process
            imports = os.pathsep.join(folder for folder in sys.path if folder)
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
            self._child = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": imports},
                **OWN_GROUP,  # so that the parent alone receives Ctrl-C
            )
        self._lines, self._done = queue.SimpleQueue(), 0
        stream = self._child.stdout
        threading.Thread(target=_read, args=(stream, self._lines), daemon=True).start()
        return self._child

    def _line(self, until: float) -> dict[str, Any]:
        """The next line of the process, as JSON; TimeoutError, or EOFError if the process ended."""
        try:
            line = self._lines.get(timeout=max(0.0, until - time.perf_counter()))
        except queue.Empty:
            raise TimeoutError from None
        if not line.endswith(b"\n"):
            raise EOFError
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _death(self) -> tuple[int, str]:
        assert self._child is not None
        try:
            code = self._child.wait(_EXIT_S)
        except subprocess.TimeoutExpired:
            code = -9  # killed
        cause = ""
        if self._errors is not None:  # the line on a fatal error, else the last one
            size = self._errors.seek(0, os.SEEK_END)
            self._errors.seek(max(0, size - _TAIL_BYTES))
            lines = self._errors.read().decode(errors="replace").splitlines()
            printed = [line.strip() for line in lines if line.strip()]
            fatal = [line for line in printed if line.startswith(_FATAL_PREFIXES)]
            cause = "".join(f": {line}" for line in (fatal or printed)[-1:])
        self._end()
        if code < 0:
            name = f"signal {-code}"
            with suppress(ValueError):
                name = signal.Signals(-code).name
            return 128 - code, f"the process was ended by {name}{cause}"
        message = f"the process ended with exit code {code}{cause}"
        return min(code, 255) or 1, message  # codes of Windows have 32 bits

    def _end(self) -> None:
        with self._mutex:
            child, self._child = self._child, None
        if child is not None:
            _kill(child)
            child.wait()
            assert child.stdin is not None
            with suppress(OSError):
                child.stdin.close()
        if self._errors is not None:
            self._errors.close()
            self._errors = None


def failed(
    task: Task,
    message: str,
    *,
    exit_code: int,
    started: datetime,
    worker: str = "",
    store: Store | None = None,
) -> Outcome:
    """Record a failed run, unless its process recorded the run before it ended.

    `message` is one sentence, `started` in UTC; `store` is that of the task, if already open.
    """
    store = store or Store(task.store)
    recorded = store.recorded(task.run)
    if recorded is not None and recorded.started >= started:
        return recorded
    record = failure_of(task, message, exit_code=exit_code, started=started, worker=worker)
    return Outcome.of(record.row, unrecorded=store.try_write(record))


def _kill(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        kill_group(child.pid)


def _read(stream: IO[bytes], lines: queue.SimpleQueue[bytes]) -> None:
    """Pass on the lines of a process; the last one is empty, or without end."""
    with stream:
        for line in stream:
            lines.put(line)
    lines.put(b"")


@dataclass(frozen=True)
class CampaignPlan:
    """Stages and options of a campaign, and its store."""

    store: Store
    campaign: str  # its name in the rows of the runs
    stages: tuple[Stage, ...]
    options: Mapping[str, Mapping[str, Any]]
    retry_failed: bool = False

    def next(self, case: Case) -> Task | Outcome:
        """The task of a case, or its outcome if that is recorded."""
        study_sha256, inputs_sha256 = case.hashes()
        task = Task(
            case=case,
            study_sha256=study_sha256,
            inputs_sha256=inputs_sha256,
            stages=self.stages,
            options=merged([self.options, case.options]),
            store=str(self.store.where),
            campaign=self.campaign,
        )
        recorded = self.store.recorded(task.run)
        if recorded is None or (self.retry_failed and recorded.status == FAILED_STATUS):
            return task
        return replace(recorded, skipped=True)


def run(
    cases: Iterable[Case],
    plan: CampaignPlan,
    workers: int,
    limits: RunLimits,
    start: Callable[[RunLimits], Runner] = Runner,
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
