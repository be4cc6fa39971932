"""Studies and logs that the pages read again and again, kept until their files change."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

from strainwave.domain import (
    Log,
    Study,
)
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_log
from strainwave.io.study import read_study

_MAX_BYTES = 512 << 20  # of all logs in memory


class _Cache:
    """Values by key; the least recently used are dropped when they exceed the size."""

    def __init__(self, max_bytes: int) -> None:
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._max, self._lock = max_bytes, Lock()

    def get(self, key: Hashable, make: Callable[[], Any], size: Callable[[Any], int]) -> Any:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key][0]
        value = make()
        with self._lock:
            self._values[key] = value, size(value)
            while len(self._values) > 1 and sum(n for _, n in self._values.values()) > self._max:
                self._values.popitem(last=False)
        return value


_cache = _Cache(_MAX_BYTES)


def study_at(path: Path) -> Study:
    """The study of a file; raises InvalidInput if it has a fault."""
    study: Study = _cache.get(("study", _stamp(path)), lambda: read_study(path), lambda _: 10_000)
    return study


def log_of(path: Path, experiment: str, *, is_whole: bool = False) -> Log:
    """The log of one experiment of a study file; raises InvalidInput if it has a fault.

    With `is_whole`, the window of the experiment is not cut out.
    """
    study = study_at(path)
    chosen = next((e for e in study.experiments if e.name == experiment), None)
    if chosen is None:
        names = ", ".join(e.name for e in study.experiments)
        raise InvalidInput(f"there is no experiment {experiment!r}", remedy=f"choose from: {names}")
    if is_whole:
        chosen = replace(chosen, start=None, stop=None)
    key = ("log", _stamp(path), experiment, is_whole, _stamp(study.log_path(chosen)))
    log: Log = _cache.get(key, lambda: read_log(study, chosen), _size)
    return log


def fingerprint(path: Path) -> str:
    """A text that changes whenever the study file or one of its logs changes."""
    study = study_at(path)
    stamps = [_stamp(study.log_path(each)) for each in study.experiments]
    text = json.dumps([hashlib.sha256(path.read_bytes()).hexdigest(), stamps])
    return hashlib.sha256(text.encode()).hexdigest()


def _stamp(path: Path) -> tuple[str, int, int]:
    """Path, size and time of change of a file; of a folder, those of its largest change."""
    status = path.stat()
    if path.is_dir():
        parts = [each.stat() for each in path.iterdir()]
        size = sum(each.st_size for each in parts)
        return str(path), size, max((p.st_mtime_ns for p in parts), default=status.st_mtime_ns)
    return str(path), status.st_size, status.st_mtime_ns


def _size(log: Log) -> int:
    return log.time.nbytes + sum(values.nbytes for values in log.channels.values())
