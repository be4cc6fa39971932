"""Cases of a campaign: studies to identify, small enough to be sent to any worker.

A worker opens a case and gets a study with its logs. Study files at a path or a URL are cases; they
are selected by files, folders, globs, tables, URLs, or one campaign.toml.
"""

from __future__ import annotations

import csv
import hashlib
import io
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

from strainwave.domain import Study
from strainwave.domain.keys import Key
from strainwave.domain.steps import files_named
from strainwave.errors import InvalidInput, import_optional, suggest_name
from strainwave.io.atomic_files import check_keys, decode, parse_toml, read_bytes
from strainwave.io.logs.arrays import Data

_VERSIONS = (  # keys with which file systems report the version of a file
    *("ETag", "etag", "md5", "checksum"),
    *("LastModified", "last_modified", "mtime", "created"),
)


def is_url(text: str) -> bool:
    """Whether the text is a URL instead of a path."""
    return "://" in text


def resolved(path: str, file: str) -> str:
    """A path or URL that a file names, relative to the folder of the file."""
    if is_url(path) or Path(path).is_absolute():
        return path
    return f"{file.rsplit('/', 1)[0]}/{path}" if is_url(file) else str(Path(file).parent / path)


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it.

    Raises `InvalidInput` if fsspec or its package for this kind of URL is not installed.
    """
    core = import_optional("fsspec.core", f"the URL {url}", "dask distributed fsspec")
    try:
        system, path = core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InvalidInput(
            f"this kind of URL cannot be read ({error})",
            where=url,
            remedy="install the package that fsspec names for it, or check the URL",
        ) from error
    return system, str(path)


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

    def hashes(self) -> tuple[str | None, str]:
        """Hashes of the study, None if it cannot be read, and of its inputs.

        Raises `InvalidInput` if the place cannot be read at all.
        """

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

    def hashes(self) -> tuple[str | None, str]:
        """SHA-256 of the study file and of the contents of its logs and its URDF.

        Files at a URL are hashed by size and version, as the file system reports them.
        """
        try:
            text = _read(self.location)
        except OSError:
            return None, hashlib.sha256().hexdigest()
        inputs = hashlib.sha256()
        for name in _list_inputs(text):
            inputs.update(f"{name}\0{_fingerprint(resolved(name, self.location))}\0".encode())
        return hashlib.sha256(text).hexdigest(), inputs.hexdigest()

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
        return files_named(tomllib.loads(text.decode("utf-8-sig")))
    except (ValueError, RecursionError):
        return []


def _read(location: str) -> bytes:
    if not is_url(location):
        return Path(location).read_bytes()
    system, path = file_system(location)
    return bytes(system.cat_file(path))


def _fingerprint(location: str) -> str:
    """A text that changes with the contents of an input; empty if it does not exist."""
    try:
        if is_url(location):
            system, path_at_url = file_system(location)
            info = system.info(path_at_url)
            known = [str(info[key]) for key in _VERSIONS if info.get(key) is not None]
            return f"{info.get('size')} {' '.join(known)}"
        path = Path(location)
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        hashes = []
        for each in files:
            with each.open("rb") as file:
                hashes.append(hashlib.file_digest(file, "sha256").hexdigest())
        return "/".join(hashes)
    except (OSError, ValueError):
        return ""


def leaves_folder(name: PurePath) -> bool:
    """Whether a name in a folder leads out of it."""
    return bool(name.anchor) or ".." in name.parts


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
        if leaves_folder(PurePath(name)):
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


_STUDY = "study.toml"
_GLOB = set("*?[")
_KEYS = ("stages", "options", "studies")


@dataclass(frozen=True)
class CaseSelection:
    """Cases in order, with stages and options of a campaign.toml."""

    cases: Sequence[Case]
    stages: tuple[str, ...] | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def find(arguments: Sequence[str]) -> CaseSelection:
    """The cases that the arguments name, each once.

    Arguments are study files; folders, searched for files named study.toml; globs; tables, .txt
    with one path per line or .csv with a column `study`; URLs of these; or one campaign.toml.
    Raises `InvalidInput` if an argument matches no study or a file is invalid.
    """
    documents = [path for path in map(Path, arguments) if _is_campaign(path)]
    if documents:
        if len(arguments) > 1:
            raise InvalidInput(
                "a campaign.toml is given with other arguments",
                where=str(documents[0]),
                remedy="give it alone, or list its studies with the others",
            )
        return _read_campaign(documents[0])
    return CaseSelection(_collect_studies(arguments))


def _collect_studies(arguments: Sequence[str]) -> list[Case]:
    cases = [
        StudyFile(name, name if is_url(name) else str(Path(name).absolute()))
        for item in arguments
        for name in _expand_argument(item)
    ]
    return list({case.location: case for case in cases}.values())


def _expand_argument(argument: str) -> list[str]:
    """Paths or URLs of the study files of one argument."""
    if is_url(argument):
        system, path = file_system(argument)
        exists, is_folder = system.exists(path), system.isdir(path)
    else:
        exists, is_folder = Path(argument).exists(), Path(argument).is_dir()
    if _GLOB & set(argument) and not exists:
        if is_url(argument):
            matches = [str(system.unstrip_protocol(item)) for item in sorted(system.glob(path))]
        else:
            anchor = Path(argument).anchor
            pattern = str(Path(argument).relative_to(anchor))
            matches = [str(item) for item in sorted(Path(anchor).glob(pattern))]
        if not matches:
            raise InvalidInput("matches no file", where=argument, remedy="check the pattern")
        return [name for match in matches for name in _expand_argument(match)]
    if is_folder:
        names = _search(argument)
        if not names:
            raise InvalidInput(
                f"there is no {_STUDY} in this folder or below",
                where=argument,
                remedy="name the study files, or a glob that matches them",
            )
        return names
    if argument.endswith((".txt", ".csv")):
        return _read_table(argument)
    if not exists:
        remedy = "check the URL"
        if not is_url(argument):
            file = Path(argument)
            others = [p.name for p in file.parent.glob("*")]
            remedy = f"check the name{suggest_name(file.name, others)}"
        raise InvalidInput("does not exist", where=argument, remedy=remedy)
    return [argument]


def _search(folder: str) -> list[str]:
    if is_url(folder):
        system, path = file_system(folder)
        paths = sorted(p for p in system.find(path) if p.rsplit("/", 1)[-1] == _STUDY)
        return [str(system.unstrip_protocol(item)) for item in paths]
    return [str(path) for path in sorted(Path(folder).rglob(_STUDY))]


def _read_table(table: str) -> list[str]:
    """Paths in a table; relative ones refer to its folder."""
    if is_url(table):
        system, path = file_system(table)
        try:
            data = bytes(system.cat_file(path))
        except OSError as error:
            raise InvalidInput(
                f"cannot be read ({error})", where=table, remedy="check the URL"
            ) from error
    else:
        data = read_bytes(Path(table), "the list of studies")
    text = decode(data, Path(table))
    if table.endswith(".csv"):
        rows = csv.DictReader(io.StringIO(text))
        if "study" not in (rows.fieldnames or ()):
            raise InvalidInput(
                "has no column 'study'",
                where=table,
                remedy="give the column of paths the name 'study'",
            )
        paths = [(row["study"] or "").strip() for row in rows]
    else:
        paths = [line.strip() for line in text.splitlines()]
    paths_in_table = [path for path in paths if path and not path.startswith("#")]
    if not paths_in_table:
        raise InvalidInput("lists no studies", where=table, remedy="write one path per line")
    return [resolved(path, table) for path in paths_in_table]


def _is_campaign(path: Path) -> bool:
    """Whether a file is a campaign.toml: it has studies, but no arm."""
    if path.suffix != ".toml" or not path.is_file():
        return False
    if path.name == "campaign.toml":
        return True
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False  # its reader reports the fault
    return "arm" not in document and "studies" in document


def _read_campaign(path: Path) -> CaseSelection:
    text = decode(read_bytes(path, "the campaign"), path)
    document = parse_toml(text, path)
    check_keys(document, _KEYS, path)
    stages, options = document.get("stages"), document.get("options", {})
    if stages is not None and not _is_list_of_text(stages):
        raise _invalid_key(path, "stages", 'a list of names, for example ["rigid"]')
    if not isinstance(options, dict) or not all(isinstance(o, dict) for o in options.values()):
        raise _invalid_key(path, "options", "one table per stage, as in a study file")
    table = document.get("studies")
    if not isinstance(table, dict) or set(table) != {"paths"} or not table["paths"]:
        raise _invalid_key(path, "studies", '[studies] with paths = ["rigs/*/study.toml", ...]')
    if not _is_list_of_text(table["paths"]):
        raise _invalid_key(path, "studies.paths", "a list of paths, folders, globs or URLs")
    cases = _collect_studies([resolved(item, str(path)) for item in table["paths"]])
    return CaseSelection(cases, None if stages is None else tuple(stages), options)


def _is_list_of_text(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _invalid_key(path: Path, key: str, wanted: str) -> InvalidInput:
    return InvalidInput(f"'{key}' is missing or invalid", where=str(path), remedy=f"give {wanted}")
