"""The process of a run: it waits for its turn, runs the commands, and records how they end.

`python -m strainwave.workbench.supervisor FOLDER`. The process and its commands form a process
group that outlives the server; nobody else writes the record while the group lives. SIGUSR1 cancels
the run.
"""

from __future__ import annotations

import fcntl
import os
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import FrameType

from strainwave.errors import InvalidInput
from strainwave.workbench.run_record import LOG, Run, State, now, read_run, status_of, write_run

CANCEL = signal.SIGUSR1
"""Signal that cancels a run."""
PATIENCE = 3.0
"""[s] that the commands of a cancelled run have to end before they are killed."""
CORES_PER_RUN = 2
"""A fit has threads; more runs at a time would share cores and memory."""

_POLL = 0.1  # [s] between two looks for a free slot
_SUCCESS = (0, 3, 4)  # 3: the data do not determine the model; 4: compared results differ


class _CancelledError(Exception):
    """The run is cancelled."""


def supervise(folder: Path, lock: int) -> None:
    """Run the commands of the record in a folder; `lock` is held by the group while it lives."""
    run = replace(read_run(folder), group=os.getpid())
    try:
        write_run(folder, run)
        with _slot():
            run = replace(run, state="running", started=now())
            write_run(folder, run)
            code = _run_commands(run, folder, lock)
        state: State = "done" if code in _SUCCESS else "failed"
        write_run(folder, run.ended_as(state, exit_code=code, status=status_of(folder)))
    except _CancelledError:
        signal.signal(CANCEL, signal.SIG_IGN)
        _end_commands()
        write_run(folder, run.ended_as("cancelled"))
    except (OSError, InvalidInput) as error:  # no slot, no program, no space
        with suppress(OSError, InvalidInput):  # without space the run ends as interrupted
            print(f"strainwave: {error}", file=sys.stderr)
            write_run(folder, run.ended_as("failed"))
    os.killpg(0, signal.SIGKILL)  # what the commands left behind


def _run_commands(run: Run, folder: Path, lock: int) -> int:
    """Run one command after the other; returns the exit code of the last one that was started."""
    for command in run.commands:
        with (folder / LOG).open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "strainwave", "--progress-json", *command],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(lock,),
            )
        code = process.wait()
        if code:
            break
    return code


def _end_commands() -> None:
    """Ask all other processes of the group to end."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.killpg(0, signal.SIGTERM)
    limit = time.monotonic() + PATIENCE
    while time.monotonic() < limit:
        try:
            os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        time.sleep(0.02)


@contextmanager
def _slot() -> Iterator[None]:
    """Hold one of the slots that this machine has for runs; waits in a queue for it."""
    folder = _slot_folder()
    files = [folder / f"slot-{k}" for k in range(max(1, (os.cpu_count() or 1) // CORES_PER_RUN))]
    ticket = folder / f"ticket-{time.time_ns()}.{os.getpid()}"
    try:
        ticket.touch()
        with (folder / "queue").open("w") as queue:
            fcntl.flock(queue, fcntl.LOCK_EX)  # the first in the queue
            while (slot := next(filter(None, map(try_lock, files)), None)) is None:
                time.sleep(_POLL)
    finally:
        ticket.unlink(missing_ok=True)
    try:
        yield
    finally:
        os.close(slot)


def runs_ahead(group: int | None) -> int | None:
    """How many runs of this user wait in front of one; None if it does not wait."""
    try:
        names = sorted(path.name for path in _slot_folder().glob("ticket-*"))
    except OSError:
        return None
    numbers = [name.rpartition(".")[2] for name in names]
    waiting = [int(number) for number in numbers if number.isdecimal() and _lives(int(number))]
    return waiting.index(group) if group in waiting else None


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (OSError, OverflowError):
        return False
    return True


def try_lock(path: Path, flags: int = os.O_CREAT) -> int | None:
    """The open file if no other run has locked it."""
    file = os.open(path, os.O_RDWR | flags, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return None
    return file


def _slot_folder() -> Path:
    """A folder of this user's runtime files; nobody else can write there."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    parent, name = (runtime, "strainwave") if runtime else (None, f"strainwave-{os.getuid()}")
    folder = Path(parent or tempfile.gettempdir()) / name
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise OSError(f"{folder} belongs to another user: delete it")
    return folder


def _cancel(_signal: int, _frame: FrameType | None) -> None:
    raise _CancelledError


if __name__ == "__main__":
    signal.signal(CANCEL, _cancel)
    supervise(Path(sys.argv[1]), int(sys.argv[2]))
