"""The served folder: its studies, and paths that cannot leave it.

Studies and logs, which the pages read again and again, are kept until their files change.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
import unicodedata
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, count
from pathlib import Path
from threading import Lock
from typing import Any

from strainwave.domain import Experiment, Log, Study
from strainwave.domain.steps import files_of
from strainwave.errors import InvalidInput, entry_of
from strainwave.io.atomic_files import decode, parse_toml, read_small
from strainwave.io.logs import read_segments
from strainwave.io.logs.bags import BAG_SUFFIXES
from strainwave.io.logs.tables import TABLE_SUFFIXES
from strainwave.io.study import read_study

_RUNS = "runs"
_MAX_DEPTH = 3  # of folders in which studies are searched
_MAX_STUDIES = 500  # listed
_MAX_STUDY_BYTES = 1 << 18
_MAX_SHOWN_NAME = 120  # letters of a name in a message
_STUDY = re.compile(rb"^\s*\[(arm|\[experiment\])\]", re.MULTILINE)
_NAME = re.compile(r"[^\W.][\w .()+=@,-]*", re.UNICODE)
_NOT_PLAIN = re.compile(r"[^\w .()+=@,-]+")
_MAX_NAME_BYTES = 110  # of a stored log, without its number
LOG_SUFFIXES = (*TABLE_SUFFIXES, *BAG_SUFFIXES)
ACCEPTED = (*LOG_SUFFIXES, ".urdf", ".yaml")
"""Endings of files that may be uploaded; metadata.yaml belongs to a bag."""


@dataclass(frozen=True, slots=True)
class Workspace:
    """A folder with studies."""

    folder: Path  # resolved
    max_upload_bytes: int
    allowed: tuple[Path, ...] = ()  # resolved; further folders whose files a study may name

    def studies(self) -> list[str]:
        """Paths of the study files, relative to the folder, sorted."""
        studies: list[str] = []
        for root, folders, files in os.walk(self.folder):
            depth = len(Path(root).relative_to(self.folder).parts)
            is_last = depth >= _MAX_DEPTH
            folders[:] = [
                f for f in folders if not is_last and not is_runs_folder(f) and f[0] not in "._"
            ]
            paths = [Path(root) / name for name in files if name.endswith(".toml")]
            studies += [str(p.relative_to(self.folder)) for p in paths if _is_study(p)]
            if len(studies) >= _MAX_STUDIES:
                break
        return sorted(studies[:_MAX_STUDIES])

    def resolve(self, relative: str) -> Path:
        """The path of a file or folder inside the folder.

        Raises InvalidInput if the path leads outside, also by a symbolic link.
        """
        return self._confined(self.folder, relative, (self.folder,))

    def file_of(self, study: Path, name: str) -> Path:
        """The path of a file that a study names, in the folder or an allowed one.

        Raises InvalidInput if the path leads outside, also by a symbolic link; whether it exists is
        not looked at.
        """
        path = self._confined(study.parent, name, (self.folder, *self.allowed))
        if path.is_dir():  # a bag
            for each in path.iterdir():
                self._confined(path, each.name, (self.folder, *self.allowed))
        return path

    def _confined(self, base: Path, name: str, roots: tuple[Path, ...]) -> Path:
        try:
            path = (base / name).resolve()
            path.exists()
        except (OSError, RuntimeError, ValueError) as error:  # too long, a loop, a null
            raise InvalidInput("is no path", where=abbreviated(name)) from error
        if not any(path.is_relative_to(root) for root in roots):
            raise InvalidInput(
                "leads out of the served folder",
                where=abbreviated(name),
                remedy="copy the file into the folder, or start strainwave serve with --allow",
            )
        return path

    def study_file(self, relative: str) -> Path:
        """The path of an existing study file; raises InvalidInput if there is none."""
        path = self.resolve(relative)
        if path.suffix != ".toml" or not path.is_file():
            raise InvalidInput("there is no such study", where=abbreviated(relative))
        if path.stat().st_size > _MAX_STUDY_BYTES:
            limit = f"has more than {_MAX_STUDY_BYTES >> 10} KiB"
            raise InvalidInput(limit, where=str(path), remedy="split the study")
        return path

    def study(self, relative: str) -> Path:
        """The path of an existing study file whose files lie in the folder or an allowed one.

        Raises InvalidInput if there is no such study, or if a file that it names lies elsewhere.
        """
        path = self.study_file(relative)
        self.files_named(path)
        return path

    def files_named(self, study: Path) -> list[Path]:
        """The logs, and the URDF if any, that a study file names.

        Raises InvalidInput if one of them lies outside.
        """
        return [self.file_of(study, name) for name in _named_files(study, stamp_of(study))]

    def files(self, patterns: Iterable[tuple[Path, str]]) -> list[Path]:
        """Regular files of the folder that match (folder, pattern), the newest first."""
        times: dict[Path, int] = {}
        for folder, pattern in patterns:
            for path in folder.glob(pattern):
                with suppress(OSError):  # a broken link, or deleted in between
                    if path.is_file() and path.resolve().is_relative_to(self.folder):
                        times[path] = path.stat().st_mtime_ns
        return sorted(times, key=lambda path: -times[path])

    def results_of(self, study: Path) -> list[Path]:
        """Results of the runs of a study, and parameter files next to it, the newest first."""
        return self.files([(runs_folder(study), "*/result.json"), (study.parent, "*.json")])

    def relative(self, path: Path) -> str:
        """The name of a path in addresses."""
        return path.relative_to(self.folder).as_posix()

    async def receive(self, folder: str, name: str, chunks: AsyncIterator[bytes]) -> Path:
        """Store an uploaded file whole or not at all, under a free name, and return its path.

        An upload that fails or is cancelled leaves nothing, also no folder. Raises InvalidInput if
        the folder cannot have logs, or if the file exceeds the limit.
        """
        parent = self.resolve(folder)
        new_folders = [each for each in (parent, *parent.parents) if not each.exists()]
        for each in new_folders:
            check_name(each.name)
        if any(part[0] == "." or is_runs_folder(part) for part in Path(folder).parts):
            raise InvalidInput("is no folder for logs", where=folder, remedy="choose another name")
        temporary = None
        try:
            parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(prefix=".upload-", dir=parent)
            size = 0
            with os.fdopen(handle, "wb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if size > self.max_upload_bytes:
                        limit = self.max_upload_bytes >> 20
                        raise InvalidInput(
                            f"has more than {limit} MiB",
                            where=name,
                            remedy="copy it into the folder, or raise --max-upload",
                        )
                    file.write(chunk)
            target = free_path(parent, name)
            os.link(temporary, target)  # fails if another upload was faster
        finally:
            if temporary:
                os.unlink(temporary)
            with suppress(OSError):  # a folder that has files stays
                for each in new_folders:
                    each.rmdir()
        return target


@lru_cache(maxsize=_MAX_STUDIES)
def _named_files(study: Path, _stamp: object) -> tuple[str, ...]:
    """The files that a study names; none if it is no TOML, since then nothing is read."""
    try:
        document = parse_toml(
            decode(read_small(study, "the study", _MAX_STUDY_BYTES), study), study
        )
    except InvalidInput:
        return ()
    experiments = document.get("experiment")
    arm, tables = document.get("arm"), experiments if isinstance(experiments, list) else []
    names = [name for each in tables if isinstance(each, dict) for name in files_of(each)]
    urdf = arm.get("urdf") if isinstance(arm, dict) else None
    return (*names, *([urdf] if isinstance(urdf, str) else []))


def abbreviated(name: str) -> str:
    """A name for a message."""
    return name if len(name) <= _MAX_SHOWN_NAME else f"{name[:_MAX_SHOWN_NAME]}..."


def _is_study(path: Path) -> bool:
    try:
        return bool(_STUDY.search(read_small(path, "the study", _MAX_STUDY_BYTES)))
    except InvalidInput:  # a broken link, a pipe, no permission
        return False


def runs_folder(study: Path) -> Path:
    """Folder of the runs of a study file: `runs`, or `runs-NAME` next to NAME.toml."""
    return study.parent / (_RUNS if study.stem == "study" else f"{_RUNS}-{study.stem}")


def is_runs_folder(name: str) -> bool:
    """Whether a folder has the runs of a study, by its name."""
    return name == _RUNS or name.startswith(f"{_RUNS}-")


def check_name(name: str) -> None:
    """Raise InvalidInput unless the text is a plain file or run name."""
    if not _NAME.fullmatch(name) or len(name) > 120:
        raise InvalidInput(
            f"{name!r} cannot be a name here",
            remedy="begin with a letter or digit, and use letters, digits, spaces and .,_-()+=@",
        )


def free_path(parent: Path, name: str) -> Path:
    """The path of a new file or folder: `name`, repaired where it is not allowed, or numbered."""
    plain = _NOT_PLAIN.sub("-", unicodedata.normalize("NFC", name))
    ending = max((each for each in ACCEPTED if plain.lower().endswith(each)), key=len, default="")
    stem, suffix = plain[: len(plain) - len(ending)], plain[len(plain) - len(ending) :]
    stem = stem.lstrip(" .-_").rstrip(" .-") or "log"
    if not suffix and is_runs_folder(stem):
        stem = f"logs {stem}"
    while len(f"{stem}{suffix}".encode()) > _MAX_NAME_BYTES:
        stem = stem[:-1].rstrip()
    numbered = (f"{stem} ({k}){suffix}" for k in count(2))
    names = chain([f"{stem}{suffix}"], numbered)
    return next(parent / each for each in names if not os.path.lexists(parent / each))


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


def study_at(path: Path) -> Study:
    """The study of a file; raises InvalidInput if it has a fault."""
    stamps = [stamp_of(path.parent / name) for name in _named_files(path, stamp_of(path))]
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
