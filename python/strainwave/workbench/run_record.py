"""The record of a run, `run.json`, in the folder of the run."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_small, write_whole
from strainwave.io.system import command_line

if TYPE_CHECKING:
    from pydantic import TypeAdapter

State = Literal["waiting", "running", "done", "failed", "cancelled", "interrupted"]
Kind = Literal["identify", "virtual", "excite", "tune", "compare"]

RECORD, LOCK, LOG = "run.json", "lock", "log.txt"
"""Files of a run that its commands do not write: its record, the lock, their messages."""
_MAX_BYTES = 1 << 20  # of a record
_MAX_RESULT_BYTES = 256 << 20  # results of large arms have some 10 MiB


@dataclass(frozen=True, slots=True)
class Run:
    """One run of one or more commands, one after the other."""

    name: str
    kind: Kind
    commands: tuple[tuple[str, ...], ...]  # without the program: ("identify", "study.toml", ...)
    created: str  # ISO 8601
    state: State = "waiting"
    exit_code: int | None = None  # of the last command
    group: int | None = None  # process group
    ended: str | None = None
    started: str | None = None  # when its first command began
    note: str = ""
    tags: tuple[str, ...] = ()  # of the user
    status: str | None = None  # of the result, once the run has ended

    @property
    def lines(self) -> list[str]:
        """The command lines, as a user types them in the folder of the run."""
        return [command_line(("strainwave", *command)) for command in self.commands]

    @property
    def is_active(self) -> bool:
        """Whether the run waits or runs, by its record."""
        return self.state in ("waiting", "running")

    @property
    def seconds(self) -> int | None:
        """Duration so far, without the wait for other runs; None if the record has no times."""
        end = now() if self.is_active else self.ended
        try:
            begin = datetime.fromisoformat(self.started or self.created)
            return round((datetime.fromisoformat(end or "") - begin).total_seconds())
        except (ValueError, TypeError, OverflowError):  # written by hand
            return None

    def ended_as(self, state: State, **values: Any) -> Run:
        """The run with its end."""
        return replace(self, state=state, ended=now(), group=None, **values)

    @classmethod
    def damaged(cls, name: str, note: str) -> Run:
        """Stands for a run that cannot be read."""
        return cls(name, "identify", (), "", state="failed", note=note)


def read_run(folder: Path) -> Run:
    """The run of a folder; a record that cannot be read gives a failed run, which can be deleted.

    Raises InvalidInput if the folder has no record.
    """
    from pydantic import ValidationError

    path = folder / RECORD
    if not path.exists():
        raise InvalidInput("there is no such run", where=folder.name)
    try:
        run = _adapter().validate_json(read_small(path, "the record", _MAX_BYTES))
    except (InvalidInput, ValidationError):
        run = None
    if run is None or not all(len(command) > 1 for command in run.commands):
        return Run.damaged(folder.name, f"{RECORD} is damaged")
    return replace(run, name=folder.name)


def write_run(folder: Path, run: Run) -> None:
    """Write the record of a run, unless its folder was deleted."""
    if folder.is_dir():
        write_whole(folder, {RECORD: json.dumps(asdict(run), indent=1).encode()})


def status_of(folder: Path) -> str | None:
    """Status in the result.json of a run's folder; None if there is none, or it is no result."""
    try:
        document = json.loads(read_small(folder / "result.json", "the result", _MAX_RESULT_BYTES))
        return str(document["status"])
    except (InvalidInput, ValueError, RecursionError, TypeError, KeyError):
        return None


def now() -> str:
    """The present time as the record has it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@cache
def _adapter() -> TypeAdapter[Run]:
    from pydantic import TypeAdapter

    return TypeAdapter(Run)
