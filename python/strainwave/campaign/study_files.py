"""Cases of study files at a path or a URL.

Cases of a campaign: studies to identify, small enough to be sent to any worker.

A worker opens a case and gets a study with its logs. `strainwave.campaign.tasks` lists the kinds:
study files, and virtual arms of a family.
"""

from __future__ import annotations

import hashlib
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol

from strainwave.campaign.places import file_system, is_url, resolved
from strainwave.domain import Study
from strainwave.domain.keys import Key
from strainwave.errors import InvalidInput
from strainwave.io.logs.arrow import Data


class Hashes(NamedTuple):
    """Hashes of the inputs of a case."""

    study_sha256: str | None  # None: the study file cannot be read
    inputs_sha256: str


@dataclass(frozen=True)
class Opened:
    """A case as `pipeline.identify` takes it."""

    study: Study | Path
    data: Data | None = None
    truth: Mapping[Key, float] = field(default_factory=dict)
    """(name, joint) -> true value of a virtual arm."""
    classes: Mapping[str, Any] = field(default_factory=dict)
    """Properties with which a virtual arm was drawn, as plain JSON values."""


class Case(Protocol):
    """One study of a campaign: a frozen dataclass of plain JSON values."""

    @property
    def name(self) -> str:
        """Value of the column `study`."""

    @property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """Options of this case, which override those of the campaign: stage -> key -> value."""

    def hashes(self) -> Hashes:
        """Hashes of the study and its inputs; `InvalidInput` if the place cannot be read at all."""

    def opened(self) -> AbstractContextManager[Opened]:
        """The study to identify; temporary copies are removed on exit.

        Raises `InvalidInput` if the study or an input is invalid.
        """


@dataclass(frozen=True)
class StudyFile:
    """A study file at a path or a URL; its logs and its URDF are relative to its folder."""

    name: str
    location: str  # absolute path, or URL
    options: ClassVar[Mapping[str, Any]] = MappingProxyType({})  # the study file contains them

    def hashes(self) -> Hashes:
        """SHA-256 of the study file and of the contents of its logs and its URDF.

        Files at a URL are hashed by size and version, as the file system reports them.
        """
        try:
            text = _read(self.location)
        except OSError:
            return Hashes(None, hashlib.sha256().hexdigest())
        inputs = hashlib.sha256()
        for name in _list_inputs(text):
            inputs.update(f"{name}\0{_fingerprint(resolved(name, self.location))}\0".encode())
        return Hashes(hashlib.sha256(text).hexdigest(), inputs.hexdigest())

    @contextmanager
    def opened(self) -> Iterator[Opened]:
        """The study file; one at a URL is copied with its files into a temporary folder.

        Raises `InvalidInput` if the study file cannot be read.
        """
        if not is_url(self.location):
            yield Opened(Path(self.location))
            return
        with tempfile.TemporaryDirectory(prefix="strainwave-") as folder:
            yield Opened(_copy_study(self.location, Path(folder)))


def _list_inputs(text: bytes) -> list[str]:
    """Files that a study names, each once; none if it is not valid TOML."""
    try:
        document = tomllib.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return []
    experiments, arm = document.get("experiment"), document.get("arm")
    files = [
        entry.get("file")
        for entry in (experiments if isinstance(experiments, list) else [])
        if isinstance(entry, dict)
    ]
    files.append(arm.get("urdf") if isinstance(arm, dict) else None)
    return list(dict.fromkeys(name for name in files if isinstance(name, str) and name))


def _read(location: str) -> bytes:
    if not is_url(location):
        return Path(location).read_bytes()
    system, path = file_system(location)
    return bytes(system.cat_file(path))


def _fingerprint(location: str) -> str:
    """A text that changes with the contents of an input; empty if it does not exist."""
    try:
        if is_url(location):
            return _version_at_url(location)
        path = Path(location)
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        return "/".join(_sha256(entry) for entry in files)
    except (OSError, ValueError):
        return ""


def _version_at_url(location: str) -> str:
    system, path = file_system(location)
    info = system.info(path)
    versions = (
        *("ETag", "etag", "md5", "checksum"),
        *("LastModified", "last_modified", "mtime", "created"),
    )
    known = [str(info[key]) for key in versions if info.get(key) is not None]
    return f"{info.get('size')} {' '.join(known)}"


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _copy_study(url: str, folder: Path) -> Path:
    """Copy a study and its existing files; the reader of the study reports missing ones."""
    try:
        text = _read(url)
    except OSError as error:
        raise InvalidInput(
            f"the study file cannot be read ({error})", where=url, remedy="check the URL"
        ) from error
    path = folder / url.rsplit("/", 1)[-1]
    path.write_bytes(text)
    for name in _list_inputs(text):
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise InvalidInput(
                f"the file {name!r} is not in the folder of the study",
                where=url,
                remedy="give a name relative to the folder of the study file",
            )
        system, source = file_system(resolved(name, url))
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if system.exists(source):
            system.get(source, str(target), recursive=bool(system.isdir(source)))
    return path
