"""The served folder: its studies, and paths that cannot leave it."""

from __future__ import annotations

import os
import re
import tempfile
import unicodedata
from collections.abc import AsyncIterator, Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_small
from strainwave.io.kept_files import MAX_STUDY_BYTES, named_files
from strainwave.io.logs.bags import BAG_SUFFIXES
from strainwave.io.logs.tables import TABLE_SUFFIXES
from strainwave.io.system import replace_file

_RUNS = "runs"
_MAX_DEPTH = 3  # of folders in which studies are searched
_MAX_STUDIES = 500  # listed
_MAX_SHOWN_NAME = 120  # letters of a name in a message
_STUDY = re.compile(rb"^\s*\[(arm|\[experiment\])\]", re.MULTILINE)
_NAME = re.compile(r"[^\W.][\w .()+=@,-]*(?<![ .])")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d) *(\.|$)", re.IGNORECASE)  # on Windows
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
            studies += [self.relative(p) for p in paths if _is_study(p)]
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
        if path.stat().st_size > MAX_STUDY_BYTES:
            limit = f"has more than {MAX_STUDY_BYTES >> 10} KiB"
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
        return [self.file_of(study, name) for name in named_files(study)]

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
            target.touch(exist_ok=False)  # fails if another upload was faster
            try:
                replace_file(Path(temporary), target)
            except OSError:
                target.unlink()
                raise
        finally:
            if temporary:
                Path(temporary).unlink(missing_ok=True)
            with suppress(OSError):  # a folder that has files stays
                for each in new_folders:
                    each.rmdir()
        return target


def abbreviated(name: str) -> str:
    """A name for a message."""
    return name if len(name) <= _MAX_SHOWN_NAME else f"{name[:_MAX_SHOWN_NAME]}..."


def _is_study(path: Path) -> bool:
    try:
        return bool(_STUDY.search(read_small(path, "the study", MAX_STUDY_BYTES)))
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
    if not _NAME.fullmatch(name) or len(name) > 120 or _RESERVED.match(name):
        raise InvalidInput(
            f"{name!r} cannot be a name here",
            remedy="begin with a letter or digit, and use letters, digits, spaces and .,_-()+=@; "
            "con, nul and other devices of Windows are no names",
        )


def free_path(parent: Path, name: str) -> Path:
    """The path of a new file or folder: `name`, repaired where it is not allowed, or numbered."""
    plain = _NOT_PLAIN.sub("-", unicodedata.normalize("NFC", name))
    ending = max((each for each in ACCEPTED if plain.lower().endswith(each)), key=len, default="")
    stem, suffix = plain[: len(plain) - len(ending)], plain[len(plain) - len(ending) :]
    stem = stem.lstrip(" .-_").rstrip(" .-") or "log"
    if (not suffix and is_runs_folder(stem)) or _RESERVED.match(stem):
        stem = f"logs {stem}"
    while len(f"{stem}{suffix}".encode()) > _MAX_NAME_BYTES:
        stem = stem[:-1].rstrip()
    numbered = (f"{stem} ({k}){suffix}" for k in count(2))
    names = chain([f"{stem}{suffix}"], numbered)
    return next(parent / each for each in names if not os.path.lexists(parent / each))
