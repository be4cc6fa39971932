"""Runs: command lines in process groups of their own, with all state in one folder each.

`FOLDER/runs/NAME/` has `run.json`, `log.txt` (the messages of the commands), and what the commands
write. The processes of a run hold a lock on `lock` while they live, so that a server that starts
again knows which runs go on and which were broken off.
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole
from strainwave.io.results import read_document
from strainwave.workbench.workspace import check_name, runs_folder

if TYPE_CHECKING:
    from pydantic import TypeAdapter

State = Literal["running", "done", "failed", "cancelled", "interrupted"]
Kind = Literal["identify", "virtual", "excite", "tune", "compare"]

_RECORD, _LOCK, LOG = "run.json", "lock", "log.txt"
RUN_FILES = frozenset((_RECORD, _LOCK, LOG))
"""Files of a run that its commands do not write."""
_PATIENCE = 3.0  # [s] of a cancelled run before it is killed


@dataclass(frozen=True, slots=True)
class Run:
    """One run of one or more commands, one after the other."""

    name: str
    kind: Kind
    commands: tuple[tuple[str, ...], ...]  # without the program: ("identify", "study.toml", ...)
    created: str  # ISO 8601
    state: State = "running"
    exit_code: int | None = None  # of the last command
    group: int | None = None  # process group of the current command
    ended: str | None = None
    note: str = ""

    @property
    def lines(self) -> list[str]:
        """The command lines, as a user types them in the folder of the run."""
        return [shlex.join(("strainwave", *command)) for command in self.commands]

    @classmethod
    def damaged(cls, name: str) -> Run:
        """Stands for a run whose record cannot be read; it can be deleted."""
        return cls(name, "identify", (), "", state="failed", note=f"{_RECORD} is damaged")


class Runs:
    """The runs of one study file."""

    def __init__(self, study: Path) -> None:
        self.folder = runs_folder(study)

    def all(self, kind: Kind | None = None) -> list[Run]:
        """Runs in the order of their start; a run that was broken off is marked."""
        if not self.folder.is_dir():
            return []
        paths = [path.parent for path in self.folder.glob(f"*/{_RECORD}")]
        runs = [self.get(path.name) for path in paths]
        return sorted((r for r in runs if kind in (None, r.kind)), key=lambda run: run.created)

    def get(self, name: str) -> Run:
        """A run by name; raises InvalidInput if there is none."""
        run = self._read(name)
        if run.state == "running" and not self._is_alive(name):
            run = self._read(name)  # it may have ended in between
            if run.state == "running":
                run = replace(run, state="interrupted", ended=_now(), group=None)
                self._write(run)
        return run

    def path(self, name: str) -> Path:
        """Folder of a run."""
        check_name(name)
        return self.folder / name

    def free_name(self, kind: str) -> str:
        """A name that no run has: identify-1."""
        names = (f"{kind}-{number}" for number in count(1))
        return next(name for name in names if not (self.folder / name).exists())

    def prepare(self, name: str) -> Path:
        """Make the folder of a run; raises InvalidInput if the name is taken or none."""
        folder = self.path(name)
        try:
            folder.mkdir(parents=True)
        except FileExistsError as error:
            raise InvalidInput(
                f"there is a run {name!r} already", remedy="choose another name"
            ) from error
        return folder

    def start(
        self, name: str, kind: Kind, commands: Sequence[Sequence[str]], note: str = ""
    ) -> Run:
        """Start the commands in the prepared folder of a run; a failing command ends the run."""
        run = Run(name, kind, tuple(map(tuple, commands)), _now(), note=note)
        lock = os.open(self.path(name) / _LOCK, os.O_CREAT | os.O_RDWR, 0o644)
        fcntl.flock(lock, fcntl.LOCK_EX)
        self._write(run)
        first = self._spawn(run, 0, lock)
        run = replace(run, group=first.pid)
        self._write(run)
        threading.Thread(target=self._follow, args=(run, first, lock), daemon=True).start()
        return run

    def cancel(self, name: str) -> Run:
        """End the process group of a run and wait for its end."""
        run = self.get(name)
        if run.state != "running" or run.group is None:
            return run
        self._write(replace(run, state="cancelled", ended=_now()))
        for ending in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(run.group, ending)
            except ProcessLookupError:
                break
            limit = time.monotonic() + _PATIENCE
            while self._is_alive(name) and time.monotonic() < limit:
                time.sleep(0.02)
            if not self._is_alive(name):
                break
        return self._read(name)

    def remove(self, name: str) -> None:
        """Delete the folder of a run that has ended; raises InvalidInput if it is running."""
        if self.get(name).state == "running":
            raise InvalidInput(f"the run {name!r} is running", remedy="cancel it first")
        shutil.rmtree(self.path(name))

    def _follow(self, run: Run, process: subprocess.Popen[bytes], lock: int) -> None:
        """Wait for each command and start the next; record the end."""
        try:
            for index in range(len(run.commands)):
                if index:
                    process = self._spawn(run, index, lock)
                    run = replace(run, group=process.pid)
                    self._write(run)
                code = process.wait()
                if self._read(run.name).state == "cancelled":
                    return
                if code != 0 and index + 1 < len(run.commands):
                    break
            # 3: the data do not determine the model; 4: compared results differ
            state: State = "done" if code in (0, 3, 4) else "failed"
            self._write(replace(run, state=state, exit_code=code, ended=_now(), group=None))
        except FileNotFoundError:
            pass  # the folder was deleted
        finally:
            os.close(lock)

    def _spawn(self, run: Run, index: int, lock: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "strainwave", "--progress-json", *run.commands[index]]
        with (self.path(run.name) / LOG).open("ab") as log:
            return subprocess.Popen(
                command,
                cwd=self.path(run.name),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                pass_fds=(lock,),
            )

    def _is_alive(self, name: str) -> bool:
        try:
            lock = os.open(self.path(name) / _LOCK, os.O_RDWR)
        except FileNotFoundError:
            return False
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(lock)
        return False

    def _read(self, name: str) -> Run:
        from pydantic import ValidationError

        try:
            run = _adapter().validate_json((self.path(name) / _RECORD).read_bytes())
        except FileNotFoundError as error:
            raise InvalidInput("there is no such run", where=name) from error
        except ValidationError:
            return Run.damaged(name)
        is_whole = all(len(command) > 1 for command in run.commands)
        return replace(run, name=name) if is_whole else Run.damaged(name)

    def _write(self, run: Run) -> None:
        if self.path(run.name).is_dir():
            text = json.dumps(asdict(run), indent=1)
            write_whole(self.path(run.name), {_RECORD: text.encode()})


def status_of(folder: Path) -> str | None:
    """Status in the result.json of a run's folder; None if there is none, or it is no result."""
    try:
        return str(read_document(folder / "result.json")["status"])
    except (InvalidInput, KeyError):
        return None


@cache
def _adapter() -> TypeAdapter[Run]:
    from pydantic import TypeAdapter

    return TypeAdapter(Run)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
