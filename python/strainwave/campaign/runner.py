"""The parent's side of a worker process: one task at a time, whatever becomes of the process."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from typing import IO, Any

from strainwave.campaign.rows import failure_of, now, worker_name
from strainwave.campaign.store import Store
from strainwave.campaign.tasks import FAILED, Limits, Outcome, Task
from strainwave.errors import InvalidInput

HUNG = 124
"""Exit code of a run beyond its time, as `timeout` gives it."""
_ENTRY = ("-m", "strainwave.campaign.worker")
_RESIDENT = 1024.0  # MiB that a worker may hold between tasks
_FAREWELL = 5.0  # [s] for a worker without tasks to end
_TAIL = 4096  # bytes of what a worker wrote to standard error last
_SAYING = ("Fatal", "Timeout", "memory allocation")  # how a line begins that says why


class Stopping(Exception):  # noqa: N818
    """The campaign ends; what was running is not recorded."""


class _Gone(Exception):  # noqa: N818
    """The process ended before it answered."""


class _Late(Exception):  # noqa: N818
    """The process did not answer in time."""


class Runner:
    """One worker process, started when it is needed, used again, and replaced when it dies.

    Parameters
    ----------
    limits : Limits
    entry : sequence of str
        Arguments of Python that start the worker.
    """

    def __init__(self, limits: Limits, entry: Sequence[str] = _ENTRY) -> None:
        self._limits = limits
        self._entry = tuple(entry)
        self._child: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._rest = b""
        self._done = 0
        self._stopped = False
        self._mutex = threading.Lock()

    def run(self, task: Task) -> Outcome:
        """Have a task done; a process that dies or hangs is a run that failed.

        Parameters
        ----------
        task : Task

        Returns
        -------
        Outcome

        Raises
        ------
        InvalidInput
            The worker process does not start.
        Stopping
            `stop` was called.
        """
        started, until = now(), time.perf_counter() + self._limits.time_s
        name = ""
        try:
            child = self._begun(task, until)
            name = worker_name(child.pid)
            answer = self._line(child, until)
        except _Late:
            self._end()
            message = f"took longer than {self._limits.time_s:g} s"
            code = HUNG
        except _Gone:
            code, message = self._death()
        else:
            self._done += 1
            self._replace_if_due(float(answer.pop("resident_mib")))
            return Outcome(**answer)
        if self._stopped:
            raise Stopping
        return failed(task, message, exit_code=code, started=started, worker=name)

    def close(self) -> None:
        """Let the process end; it has no task."""
        child = self._child
        if child is not None and child.stdin is not None:
            with suppress(OSError):
                child.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                child.wait(_FAREWELL)
        self._end()

    def stop(self) -> None:
        """End the process now, from any thread; `run` raises `Stopping`."""
        with self._mutex:
            self._stopped = True
            if self._child is not None:
                _kill(self._child)

    def _begun(self, task: Task, until: float) -> subprocess.Popen[bytes]:
        """A process that has begun the task; one that died meanwhile is replaced once."""
        line = (task.to_json() + "\n").encode()
        for _ in range(2):
            child = self._started()
            with suppress(BrokenPipeError):
                assert child.stdin is not None
                child.stdin.write(line)
                child.stdin.flush()
            try:
                self._line(child, until)
            except _Gone:
                if self._stopped:
                    raise
                _, message = self._death()
                continue
            return child
        raise InvalidInput(
            f"the worker process does not start: {message}",
            where=None if self._limits.memory_mib is None else "--memory-limit",
            remedy="allow more memory"
            if self._limits.memory_mib is not None
            else "run `python -m strainwave.campaign.worker --time-limit 60` to see why",
        )

    def _started(self) -> subprocess.Popen[bytes]:
        if self._child is not None and self._child.poll() is None:
            return self._child
        self._end()
        arguments = [*self._entry, "--time-limit", str(self._limits.time_s)]
        if self._limits.memory_mib is not None:
            arguments += ["--memory-limit", str(self._limits.memory_mib)]
        with self._mutex:
            if self._stopped:
                raise Stopping
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
            self._child = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": _path()},
                start_new_session=True,  # Ctrl-C in the terminal is the parent's
            )
        self._rest, self._done = b"", 0
        return self._child

    def _line(self, child: subprocess.Popen[bytes], until: float) -> dict[str, Any]:
        """The next line of the process."""
        assert child.stdout is not None
        while b"\n" not in self._rest:
            ready, _, _ = select.select(
                [child.stdout], [], [], max(0.0, until - time.perf_counter())
            )
            if not ready:
                raise _Late
            block = os.read(child.stdout.fileno(), 2**16)
            if not block:
                raise _Gone
            self._rest += block
        line, self._rest = self._rest.split(b"\n", 1)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _death(self) -> tuple[int, str]:
        """Exit code and cause of a process that has ended."""
        assert self._child is not None
        try:
            code = self._child.wait(_FAREWELL)
        except subprocess.TimeoutExpired:
            code = -signal.SIGKILL
        last = self._last_words()
        self._end()
        if code < 0:
            with suppress(ValueError):
                return 128 - code, f"the process was ended by {signal.Signals(-code).name}{last}"
            return 128 - code, f"the process was ended by signal {-code}{last}"
        return code or 1, f"the process ended with exit code {code}{last}"

    def _last_words(self) -> str:
        """The line of standard error that says most: the fatal error's, or the last."""
        if self._errors is None:
            return ""
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - _TAIL))
        lines = self._errors.read().decode(errors="replace").splitlines()
        spoken = [line.strip() for line in lines if line.strip()]
        fatal = [line for line in spoken if line.startswith(_SAYING)]
        chosen = [*spoken[-1:], *fatal[-1:]]
        return f": {chosen[-1]}" if chosen else ""

    def _replace_if_due(self, resident_mib: float) -> None:
        most = self._limits.memory_mib
        allowed = _RESIDENT if most is None else 0.5 * most
        if self._done >= self._limits.tasks or resident_mib > allowed:
            self.close()

    def _end(self) -> None:
        with self._mutex:
            child, self._child = self._child, None
        if child is not None:
            _kill(child)
            child.wait()
            for stream in (child.stdin, child.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()
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
    """Record a run whose process did not, unless it had done so before it ended.

    Parameters
    ----------
    task : Task
    message : str
        Why, in one sentence.
    exit_code : int
    started : datetime
        UTC, without a zone.
    worker : str
        Whose process ended.
    store : Store, optional
        The task's, where it is at hand.

    Returns
    -------
    Outcome
    """
    store, unrecorded = store or Store.at(task.store), ""
    known = store.recorded(task.run)
    if known is not None and known.started >= started:
        return Outcome.of(task.run, task.case.name, known)
    seconds = (now() - started).total_seconds()
    record = failure_of(
        task, message, exit_code=exit_code, started=started, seconds=seconds, worker=worker
    )
    try:
        store.write(record)
    except OSError as error:
        unrecorded = error.strerror or str(error)
    return Outcome(
        run=task.run,
        study=task.case.name,
        status=FAILED,
        exit_code=exit_code,
        message=message,
        seconds=seconds,
        unrecorded=unrecorded,
    )


def _kill(child: subprocess.Popen[bytes]) -> None:
    """The process and those that it started."""
    if child.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)


def _path() -> str:
    """Where this process finds its modules, so that the worker finds the same."""
    return os.pathsep.join(each for each in sys.path if each)
