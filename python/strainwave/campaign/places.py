"""Where files lie: a local path or a URL, read and written through one interface.

A file appears whole or not at all. Local files are written aside, flushed to the disk and renamed;
an object store puts whole objects.
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
from typing import Any, Protocol

from strainwave.errors import InvalidInput

_ABANDONED = 3600.0  # [s] after which a file written aside has no writer


def is_url(text: str) -> bool:
    """Whether a place is named by a URL in place of a path.

    Parameters
    ----------
    text : str

    Returns
    -------
    bool
    """
    return "://" in text


class Place(Protocol):
    """A folder of whole files, by names with slashes relative to it."""

    def __str__(self) -> str: ...

    def put(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all.

        Raises
        ------
        OSError
            It cannot be written; nothing of it can be read.
        """

    def get(self, name: str) -> bytes:
        """A file's bytes.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        """

    def names(self, folder: str, ending: str) -> list[str]:
        """Files of a folder by their ending, as `folder/file`; none where there is no folder."""

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""

    def delete(self, names: Iterable[str]) -> None:
        """Remove files; those that are gone already do not matter."""

    @contextmanager
    def lock(self) -> Iterator[bool]:
        """Hold the folder's lock; false, at once, where another holds it or there is none."""


@dataclass(frozen=True)
class Folder:
    """A local folder."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    def put(self, name: str, data: bytes) -> None:
        """Write aside under a name that no reader matches, flush, rename."""
        final = self.path / name
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, aside = tempfile.mkstemp(
            prefix=f".{final.name}.", suffix=".aside", dir=final.parent
        )
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(aside).chmod(0o644)
            Path(aside).replace(final)
        except OSError:
            with suppress(OSError):
                Path(aside).unlink()
            raise

    def get(self, name: str) -> bytes:
        """A file's bytes."""
        return (self.path / name).read_bytes()

    def names(self, folder: str, ending: str) -> list[str]:
        """Files of a folder by their ending; those written aside begin with a dot."""
        try:
            with os.scandir(self.path / folder) as entries:
                found = [e.name for e in entries if e.name.endswith(ending) and e.name[0] != "."]
        except FileNotFoundError:
            return []
        return [f"{folder}/{name}" for name in sorted(found)]

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""
        return (self.path / name).exists()

    def delete(self, names: Iterable[str]) -> None:
        """Remove files; those that are gone already do not matter."""
        for name in names:
            (self.path / name).unlink(missing_ok=True)

    def sweep(self, folder: str) -> None:
        """Remove what processes that died had written aside."""
        before = time.time() - _ABANDONED
        for path in (self.path / folder).glob(".*.aside"):
            with suppress(OSError):  # renamed meanwhile
                if path.stat().st_mtime < before:
                    path.unlink()

    @contextmanager
    def lock(self) -> Iterator[bool]:
        """Hold `.lock` in the folder; false where another process holds it."""
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
        return file_system(f"{self.url.rstrip('/')}/{name}")

    def put(self, name: str, data: bytes) -> None:
        """Put a whole object; on a file system without objects, write aside and move."""
        system, path = self._at(name)
        if "file" not in _protocols(system):
            system.pipe_file(path, data)
            return
        Folder(Path(path).parent).put(Path(path).name, data)

    def get(self, name: str) -> bytes:
        """A file's bytes."""
        system, path = self._at(name)
        return bytes(system.cat_file(path))

    def names(self, folder: str, ending: str) -> list[str]:
        """Files of a folder by their ending."""
        system, path = self._at(folder)
        system.invalidate_cache()
        try:
            found = [str(each).rsplit("/", 1)[-1] for each in system.ls(path, detail=False)]
        except FileNotFoundError:
            return []
        return [f"{folder}/{n}" for n in sorted(found) if n.endswith(ending) and n[0] != "."]

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""
        system, path = self._at(name)
        system.invalidate_cache()
        return bool(system.exists(path))

    def delete(self, names: Iterable[str]) -> None:
        """Remove files; those that are gone already do not matter."""
        for name in names:
            system, path = self._at(name)
            with suppress(FileNotFoundError):
                system.rm_file(path)

    @contextmanager
    def lock(self) -> Iterator[bool]:
        """An object store has no locks."""
        yield False


def place_of(where: Path | str) -> Place:
    """The folder at a path or a URL.

    Parameters
    ----------
    where : Path or str

    Returns
    -------
    Place
    """
    return Bucket(where) if isinstance(where, str) and is_url(where) else Folder(Path(where))


def file_system(url: str) -> tuple[Any, str]:
    """What reads a URL, and the path in it.

    Parameters
    ----------
    url : str

    Returns
    -------
    (fsspec.AbstractFileSystem, str)

    Raises
    ------
    InvalidInput
        fsspec is not installed, or what it needs for this kind of URL.
    """
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise InvalidInput(
            "a URL needs fsspec, which is not installed",
            where=url,
            remedy='pip install "strainwave[cluster]", or give a path',
        ) from error
    try:
        system, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InvalidInput(
            f"this kind of URL cannot be read ({error})",
            where=url,
            remedy="install the package that fsspec names for it, or check the URL",
        ) from error
    return system, str(path)


def _protocols(system: Any) -> tuple[str, ...]:
    found = system.protocol
    return (found,) if isinstance(found, str) else tuple(found)
