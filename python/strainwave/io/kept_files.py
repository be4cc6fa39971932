"""Studies and logs that are read again and again, kept in memory until their files change."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

from strainwave.domain import Experiment, Log, Study
from strainwave.domain.steps import files_named
from strainwave.errors import InvalidInput, entry_of
from strainwave.io.atomic_files import decode, parse_toml, read_small
from strainwave.io.logs import read_segments
from strainwave.io.study import read_study

MAX_STUDY_BYTES = 1 << 18
"""Largest study file that is read."""
_MAX_STUDIES = 500  # whose files are known
_MAX_BYTES = 256 << 20  # of all logs in memory
_STUDY_SIZE = 10_000  # [bytes] of a study, or of a fault
_cache: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()  # value and size by key
_cache_lock = Lock()


def cached(key: Hashable, make: Callable[[], Any], size: Callable[[Any], int]) -> Any:
    """A value by key, or its fault; at more than `_MAX_BYTES`, the least recently used go."""
    with _cache_lock:
        if key in _cache:
            _cache.move_to_end(key)
        value, n_bytes = _cache.get(key, (None, 0))
    if not n_bytes:
        try:
            value = make()
            n_bytes = size(value)
        except InvalidInput as error:
            value, n_bytes = error, _STUDY_SIZE
        with _cache_lock:
            _cache[key] = value, n_bytes
            while len(_cache) > 1 and sum(n for _, n in _cache.values()) > _MAX_BYTES:
                _cache.popitem(last=False)
    if isinstance(value, InvalidInput):
        raise value.with_traceback(None)
    return value


def named_files(study: Path) -> tuple[str, ...]:
    """The files that a study file names; none if it is no TOML, since then nothing is read."""
    return _named_files(study, stamp_of(study))


@lru_cache(maxsize=_MAX_STUDIES)
def _named_files(study: Path, _stamp: object) -> tuple[str, ...]:
    try:
        text = decode(read_small(study, "the study", MAX_STUDY_BYTES), study)
        return tuple(files_named(parse_toml(text, study)))
    except InvalidInput:
        return ()


def study_at(path: Path) -> Study:
    """The study of a file; raises InvalidInput if it has a fault."""
    stamps = [stamp_of(path.parent / name) for name in named_files(path)]
    key = ("study", stamp_of(path), *stamps)  # a URDF decides, and whether files exist
    study: Study = cached(key, lambda: read_study(path), lambda _: _STUDY_SIZE)
    return study


def experiment_of(path: Path, name: str) -> Experiment:
    """An experiment of a study file; raises InvalidInput if there is none of that name."""
    return entry_of(
        {each.name: each for each in study_at(path).experiments}, name, "experiment", ""
    )


def log_of(path: Path, experiment: str) -> Log:
    """The log of one experiment of a study file, of a record with pauses the longest segment.

    Raises InvalidInput if it has a fault.
    """
    chosen = experiment_of(path, experiment)
    segments = segments_of(path, chosen)
    return segments[0] if len(segments) == 1 else replace(max(segments, key=len), experiment=chosen)


def segments_of(path: Path, experiment: Experiment) -> tuple[Log, ...]:
    """The segments of an experiment, whose window and steps may differ from the study file's.

    Raises InvalidInput if the log has a fault.
    """
    study = study_at(path)
    how = experiment.start, experiment.stop, experiment.steps
    stamps = map(stamp_of, study.log_paths(experiment))
    key = ("log", stamp_of(path), experiment.name, *how, *stamps)
    logs: tuple[Log, ...] = cached(
        key, lambda: read_segments(study, experiment), lambda logs: sum(map(_size, logs))
    )
    return logs


def fingerprint(path: Path) -> str:
    """A text that changes whenever the study file or one of its logs changes."""
    study = study_at(path)
    stamps = [stamp_of(log) for each in study.experiments for log in study.log_paths(each)]
    text = json.dumps([hashlib.sha256(path.read_bytes()).hexdigest(), stamps])
    return hashlib.sha256(text.encode()).hexdigest()


def stamp_of(path: Path) -> tuple[str, int, int]:
    """Path, size and time of change of a file; of a folder, those of its largest change.

    The size of what cannot be looked at is -1.
    """
    try:
        status = path.stat()
        if path.is_dir():
            parts = [each.stat() for each in path.iterdir()]
            size = sum(each.st_size for each in parts)
            return str(path), size, max((p.st_mtime_ns for p in parts), default=status.st_mtime_ns)
    except (OSError, ValueError):
        return str(path), -1, 0
    return str(path), status.st_size, status.st_mtime_ns


def _size(log: Log) -> int:
    return log.time.nbytes + sum(values.nbytes for values in log.channels.values())
