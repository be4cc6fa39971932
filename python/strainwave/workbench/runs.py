"""Runs: command lines in process groups of their own, with all state in one folder each.

`FOLDER/runs/NAME/` has `run.json`, `log.txt` (the messages of the commands), and what the commands
write. The processes of a run hold a lock on `lock` while they live, so that any server knows which
runs go on and which were broken off.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path

from strainwave.errors import InvalidInput
from strainwave.io import system
from strainwave.io.atomic_files import write_whole
from strainwave.workbench import supervisor
from strainwave.workbench.run_record import LOCK, LOG, RECORD, Kind, Run, now, read_run, write_run
from strainwave.workbench.supervisor import CANCEL, PATIENCE
from strainwave.workbench.workspace import check_name, runs_folder

RUN_FILES = frozenset((RECORD, LOCK, LOG, CANCEL))
"""Files of a run that its commands do not write."""
_MAX_TAGS = 20  # of a run
_POLL = 0.05  # [s] between two looks at a run that is being cancelled
MAX_LISTED = 500
"""Runs in a list, those whose records are the newest."""


class Runs:
    """The runs of one study file."""

    def __init__(self, study: Path) -> None:
        self.folder = runs_folder(study.resolve())

    def all(self) -> list[Run]:
        """The `MAX_LISTED` newest runs in the order of their start, the interrupted ones marked."""
        times: dict[str, int] = {}
        for path in self._records():
            with suppress(OSError):  # deleted in between
                times[path.parent.name] = path.lstat().st_mtime_ns
        newest = sorted(times, key=lambda name: times[name])[-MAX_LISTED:]
        return sorted(map(self.listed, newest), key=lambda run: run.created)

    def count(self) -> int:
        """Number of all runs."""
        return sum(1 for _ in self._records())

    def _records(self) -> Iterator[Path]:
        return self.folder.glob(f"*/{RECORD}") if self.folder.is_dir() else iter(())

    def listed(self, name: str) -> Run:
        """A run, or what stands for one that cannot be read."""
        try:
            return self.get(name)
        except InvalidInput as error:
            return Run.damaged(name, str(error))

    def get(self, name: str) -> Run:
        """A run by name; raises InvalidInput if there is none."""
        folder = self.path(name)
        run = read_run(folder)
        if run.is_active and not self._is_alive(name):
            run = read_run(folder)  # it may have ended in between
            if run.is_active:
                run = run.ended_as("interrupted")
                with suppress(InvalidInput):  # no space: the next one to look writes it
                    write_run(folder, run)
        return run

    def path(self, name: str) -> Path:
        """Folder of a run; raises InvalidInput if the name is none, or a link."""
        check_name(name)
        folder = self.folder / name
        if folder.resolve() != folder:
            raise InvalidInput("a run must not be a link", where=name, remedy="copy its folder")
        return folder

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
            problem = f"there is a run {name!r} already"
            raise InvalidInput(problem, remedy="choose another name") from error
        return folder

    def start(
        self,
        name: str,
        kind: Kind,
        commands: Sequence[Sequence[str]],
        note: str = "",
        files: Mapping[str, bytes] | None = None,
    ) -> Run:
        """Start the commands in the prepared folder of a run; a failing command ends the run.

        `files` are written first. The folder is deleted if the run does not start.
        """
        try:
            write_whole(self.path(name), files or {})
            return self._start(Run(name, kind, tuple(map(tuple, commands)), now(), note=note))
        except (InvalidInput, OSError):
            shutil.rmtree(self.path(name), ignore_errors=True)
            raise

    def _start(self, run: Run) -> Run:
        folder = self.path(run.name)
        lock = system.try_lock(folder / LOCK)
        assert lock is not None  # nobody else knows the folder yet
        try:
            write_run(folder, run)
            with (folder / LOG).open("ab") as log:
                process = subprocess.Popen(
                    [sys.executable, "-m", supervisor.__name__, str(folder), str(lock)],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    **system.OWN_GROUP,
                    **system.inheriting(lock),
                )
        finally:
            system.unlock(lock)
        threading.Thread(target=process.wait, daemon=True).start()  # reaps the process
        return replace(run, group=process.pid)

    def cancel(self, name: str) -> Run:
        """End the process group of a run and wait for its end."""
        run, request = self.get(name), self.path(name) / CANCEL
        limit = time.monotonic() + 2.0 * PATIENCE
        if run.is_active:
            with suppress(OSError):  # no space: the run is killed after the limit
                request.touch()
        while self._is_alive(name) and time.monotonic() < limit:
            time.sleep(_POLL)
            run = self.get(name)
        if run.is_active and run.group is not None:
            system.kill_group(run.group)
            write_run(self.path(name), run.ended_as("cancelled"))
        run = self.get(name)
        if not run.is_active:  # else the process of the run starts slowly, and is still to see it
            request.unlink(missing_ok=True)
        return run

    def remove(self, name: str) -> None:
        """Delete the folder of a run that has ended; raises InvalidInput if it is running."""
        if self.get(name).is_active:
            raise InvalidInput(f"the run {name!r} is running", remedy="cancel it first")
        shutil.rmtree(self.path(name))

    def tag(self, name: str, tag: str, *, is_set: bool) -> None:
        """Set or remove a tag of a run that has ended.

        Raises InvalidInput if the run cannot have the tag.
        """
        run = self.get(name)
        if run.is_active or not run.commands:  # its processes write the record, or it is damaged
            reason = "is not finished" if run.is_active else f"has no record ({run.note})"
            raise InvalidInput(f"the run {name!r} {reason}", remedy="tag other runs")
        check_name(tag)
        others = tuple(each for each in run.tags if each != tag)
        tags = (*others, tag) if is_set else others
        if len(tags) > _MAX_TAGS:
            raise InvalidInput(f"the run {name!r} has {_MAX_TAGS} tags", remedy="remove one first")
        write_run(self.path(name), replace(run, tags=tags))

    def _is_alive(self, name: str) -> bool:
        return system.is_locked(self.path(name) / LOCK)
