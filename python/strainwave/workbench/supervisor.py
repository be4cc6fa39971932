"""The process of a run: it waits for its turn, runs the commands, and records how they end.

`python -m strainwave.workbench.supervisor FOLDER`. The process and its commands form a process
group that outlives the server; nobody else writes the record while the group lives. The file
`cancel` in the folder cancels the run.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from strainwave.errors import InvalidInput
from strainwave.io import system
from strainwave.workbench.run_record import LOG, Run, State, now, read_run, status_of, write_run

CANCEL = "cancel"
"""File in the folder of a run that cancels it."""
PATIENCE = 3.0
"""[s] that the commands of a cancelled run have to end before they are killed."""
CORES_PER_RUN = 2
"""A fit has threads; more runs at a time would share cores and memory."""

_POLL = 0.1  # [s] between two looks for a free slot, or for the end of a command
_SUCCESS = (0, 3, 4)  # 3: the data do not determine the model; 4: compared results differ


class _CancelledError(Exception):
    """The run is cancelled."""


def supervise(folder: Path, lock: int) -> None:
    """Run the commands of the record in a folder; `lock` is held by the group while it lives."""
    run = replace(read_run(folder), group=os.getpid())
    try:
        write_run(folder, run)
        with _slot(folder):
            run = replace(run, state="running", started=now())
            write_run(folder, run)
            code = _run_commands(run, folder, lock)
        state: State = "done" if code in _SUCCESS else "failed"
        write_run(folder, run.ended_as(state, exit_code=code, status=status_of(folder)))
    except _CancelledError:
        write_run(folder, run.ended_as("cancelled"))
    except (OSError, InvalidInput) as error:  # no slot, no program, no space
        with suppress(OSError, InvalidInput):  # without space the run ends as interrupted
            print(f"strainwave: {error}", file=sys.stderr)
            write_run(folder, run.ended_as("failed"))
    system.kill_group(os.getpid())  # this process, and what the commands left behind


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
                env=os.environ | {"PYTHONIOENCODING": "utf-8"},  # of the log
                **system.inheriting(lock),
            )
        code = _wait_for(process, folder)
        if code:
            break
    return code


def _wait_for(command: subprocess.Popen[bytes], folder: Path) -> int:
    """Exit code of a command; if the run is cancelled, the command is ended."""
    while True:
        try:
            return command.wait(_POLL)
        except subprocess.TimeoutExpired:
            if (folder / CANCEL).exists():
                system.ask_to_end(command)
                with suppress(subprocess.TimeoutExpired):
                    command.wait(PATIENCE)
                raise _CancelledError from None


@contextmanager
def _slot(run_folder: Path) -> Iterator[None]:
    """Hold one of the slots that this machine has for runs; waits in a queue for it."""
    folder = system.user_folder()
    files = [folder / f"slot-{k}" for k in range(max(1, (os.cpu_count() or 1) // CORES_PER_RUN))]
    ticket = folder / f"ticket-{time.time_ns()}.{os.getpid()}"
    while (place := system.try_lock(ticket)) is None:  # another run looks whether it is held
        time.sleep(_POLL)
    try:
        while (slot := _free_slot(files)) is None:
            if (run_folder / CANCEL).exists():
                raise _CancelledError
            time.sleep(_POLL)
    finally:
        system.unlock(place)
        with suppress(OSError):
            ticket.unlink()
    try:
        yield
    finally:
        system.unlock(slot)


def _free_slot(files: Sequence[Path]) -> int | None:
    """A slot for the first run in the queue; None if there is none, or for other runs."""
    if runs_ahead(os.getpid()):
        return None
    return next((slot for slot in map(system.try_lock, files) if slot is not None), None)


def runs_ahead(group: int | None) -> int | None:
    """How many runs of this user wait in front of one; None if it does not wait."""
    try:
        tickets = sorted(system.user_folder().glob("ticket-*"))
    except OSError:
        return None
    waiting = [path.name.rpartition(".")[2] for path in tickets if system.is_locked(path)]
    return waiting.index(str(group)) if str(group) in waiting else None


if __name__ == "__main__":
    supervise(Path(sys.argv[1]), int(sys.argv[2]))
