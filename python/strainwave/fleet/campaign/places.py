"""Folders at a local path or a URL, with one interface.

A file appears completely or not at all. Local files are written to a temporary file, flushed to the
disk and renamed; an object store writes whole objects.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput, import_optional

_MAX_WRITE_S = 3600.0  # [s]; the process that wrote an older temporary file has died


def is_url(text: str) -> bool:
    """Whether the text is a URL instead of a path."""
    return "://" in text


def resolved(path: str, file: str) -> str:
    """A path or URL that a file names, relative to the folder of the file."""
    if is_url(path) or Path(path).is_absolute():
        return path
    return f"{file.rsplit('/', 1)[0]}/{path}" if is_url(file) else str(Path(file).parent / path)


@dataclass(frozen=True)
class Folder:
    """A local folder; `put` raises OSError, `get` FileNotFoundError if that fails."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    def put(self, name: str, data: bytes) -> None:
        """Write a hidden temporary file, flush it to the disk, and rename it."""
        final = self.path / name
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(
            prefix=f".{final.name}.", suffix=".aside", dir=final.parent
        )
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(temporary).chmod(0o644)
            Path(temporary).replace(final)
        except OSError:
            with suppress(OSError):
                Path(temporary).unlink()
            raise

    def get(self, name: str) -> bytes:
        """A file's bytes."""
        return (self.path / name).read_bytes()

    def names(self, folder: str, ending: str) -> list[str]:
        """Files of a subfolder by ending; temporary files begin with a dot."""
        try:
            with os.scandir(self.path / folder) as entries:
                names = [e.name for e in entries if e.name.endswith(ending) and e.name[0] != "."]
        except FileNotFoundError:
            return []
        return [f"{folder}/{name}" for name in sorted(names)]

    def exists(self, name: str) -> bool:
        """Whether the file exists."""
        return (self.path / name).exists()

    def delete(self, names: Iterable[str]) -> None:
        """Delete files that still exist."""
        for name in names:
            (self.path / name).unlink(missing_ok=True)

    def sweep(self, folder: str) -> None:
        """Delete temporary files of processes that died."""
        before = time.time() - _MAX_WRITE_S
        for path in (self.path / folder).glob(".*.aside"):
            with suppress(OSError):  # renamed in the meantime
                if path.stat().st_mtime < before:
                    path.unlink()

    @contextmanager
    def lock(self) -> Iterator[bool]:
        """Hold `.lock` in the folder; yields false if another process holds it."""
        with (self.path / ".lock").open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:  # held, or a file system without locks
                yield False
                return
            yield True


@dataclass(frozen=True)
class Bucket:
    """A folder at a URL, through fsspec."""

    url: str

    def __str__(self) -> str:
        return self.url

    def _at(self, name: str) -> tuple[Any, str]:
        system, path = file_system(f"{self.url.rstrip('/')}/{name}")
        system.invalidate_cache()  # other processes write
        return system, path

    def put(self, name: str, data: bytes) -> None:
        """Write a whole object; on a local file system as `Folder` does."""
        system, path = self._at(name)
        protocol = system.protocol
        if "file" not in ((protocol,) if isinstance(protocol, str) else tuple(protocol)):
            system.pipe_file(path, data)
            return
        Folder(Path(path).parent).put(Path(path).name, data)

    def get(self, name: str) -> bytes:
        """A file's bytes."""
        system, path = self._at(name)
        return bytes(system.cat_file(path))

    def names(self, folder: str, ending: str) -> list[str]:
        """Files of a subfolder by ending."""
        system, path = self._at(folder)
        try:
            names = [str(each).rsplit("/", 1)[-1] for each in system.ls(path, detail=False)]
        except FileNotFoundError:
            return []
        return [f"{folder}/{n}" for n in sorted(names) if n.endswith(ending) and n[0] != "."]

    def exists(self, name: str) -> bool:
        """Whether the file exists."""
        system, path = self._at(name)
        return bool(system.exists(path))

    def delete(self, names: Iterable[str]) -> None:
        """Delete files that still exist."""
        for name in names:
            system, path = self._at(name)
            with suppress(FileNotFoundError):
                system.rm_file(path)


Place = Folder | Bucket
"""A folder whose files have names with slashes relative to it."""


def place_of(where: Path | str) -> Place:
    """The folder at a path or a URL."""
    return Bucket(where) if isinstance(where, str) and is_url(where) else Folder(Path(where))


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it.

    Raises `InvalidInput` if fsspec or its package for this kind of URL is not installed.
    """
    core = import_optional("fsspec.core", f"the URL {url}", '"strainwave[cluster]"')
    try:
        system, path = core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InvalidInput(
            f"this kind of URL cannot be read ({error})",
            where=url,
            remedy="install the package that fsspec names for it, or check the URL",
        ) from error
    return system, str(path)
