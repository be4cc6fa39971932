"""Studies of a campaign: files, folders, globs, tables, URLs, or one campaign.toml."""

from __future__ import annotations

import csv
import io
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from strainwave.campaign.places import file_system, is_url, resolved
from strainwave.campaign.study_files import Case, StudyFile
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.atomic_files import check_keys, decode, parse_toml, read_bytes

_STUDY = "study.toml"
_GLOB = set("*?[")
_KEYS = ("stages", "options", "studies")


@dataclass(frozen=True)
class Selection:
    """Cases in order, with stages and options of a campaign.toml."""

    cases: Sequence[Case]
    stages: tuple[str, ...] | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def find(arguments: Sequence[str]) -> Selection:
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
    return Selection(_collect_studies(arguments))


def _collect_studies(arguments: Sequence[str]) -> list[Case]:
    cases = [
        StudyFile(name, name if is_url(name) else str(Path(name).absolute()))
        for item in arguments
        for name in _expand_argument(item)
    ]
    return list({case.location: case for case in cases}.values())


def _expand_argument(argument: str) -> list[str]:
    """Paths or URLs of the study files of one argument."""
    where = _Url(argument) if is_url(argument) else _Local(argument)
    if _GLOB & set(argument) and not where.exists():
        matches = where.matches()
        if not matches:
            raise InvalidInput("matches no file", where=argument, remedy="check the pattern")
        return [name for match in matches for name in _expand_argument(match)]
    if where.is_folder():
        names = where.search()
        if not names:
            raise InvalidInput(
                f"there is no {_STUDY} in this folder or below",
                where=argument,
                remedy="name the study files, or a glob that matches them",
            )
        return names
    if argument.endswith((".txt", ".csv")):
        return _read_table(argument, where.read())
    if not where.exists():
        raise InvalidInput("does not exist", where=argument, remedy=where.hint())
    return [argument]


def _read_table(table: str, data: bytes) -> list[str]:
    """Paths in a table; relative ones refer to its folder."""
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


@dataclass(frozen=True)
class _Local:
    """A path on this machine."""

    text: str

    def exists(self) -> bool:
        return Path(self.text).exists()

    def is_folder(self) -> bool:
        return Path(self.text).is_dir()

    def search(self) -> list[str]:
        return [str(path) for path in sorted(Path(self.text).rglob(_STUDY))]

    def matches(self) -> list[str]:
        path = Path(self.text)
        pattern = str(path.relative_to(path.anchor))
        return [str(item) for item in sorted(Path(path.anchor).glob(pattern))]

    def read(self) -> bytes:
        return read_bytes(Path(self.text), "the list of studies")

    def hint(self) -> str:
        path = Path(self.text)
        return f"check the name{suggest_name(path.name, [p.name for p in path.parent.glob('*')])}"


@dataclass(frozen=True)
class _Url:
    """A URL that fsspec reads."""

    text: str

    def exists(self) -> bool:
        system, path = file_system(self.text)
        return bool(system.exists(path))

    def is_folder(self) -> bool:
        system, path = file_system(self.text)
        return bool(system.isdir(path))

    def search(self) -> list[str]:
        system, path = file_system(self.text)
        paths = sorted(p for p in system.find(path) if p.rsplit("/", 1)[-1] == _STUDY)
        return [str(system.unstrip_protocol(item)) for item in paths]

    def matches(self) -> list[str]:
        system, path = file_system(self.text)
        return [str(system.unstrip_protocol(item)) for item in sorted(system.glob(path))]

    def read(self) -> bytes:
        system, path = file_system(self.text)
        try:
            return bytes(system.cat_file(path))
        except OSError as error:
            raise InvalidInput(
                f"cannot be read ({error})", where=self.text, remedy="check the URL"
            ) from error

    def hint(self) -> str:
        return "check the URL"


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


def _read_campaign(path: Path) -> Selection:
    text = decode(read_bytes(path, "the campaign"), path)
    document = parse_toml(text, path)
    check_keys(document, _KEYS, path)
    stages, options = document.get("stages"), document.get("options", {})
    if stages is not None and not _is_list_of_text(stages):
        raise _invalid_key(path, "stages", 'a list of names, for example ["rigid"]')
    if not isinstance(options, dict) or not all(isinstance(o, dict) for o in options.values()):
        raise _invalid_key(path, "options", "one table per stage, as in a study file")
    return Selection(
        _collect_listed(document, path),
        stages=None if stages is None else tuple(stages),
        options=options,
    )


def _collect_listed(document: Mapping[str, Any], path: Path) -> Sequence[Case]:
    """Cases of `[studies]`."""
    table = document.get("studies")
    if not isinstance(table, dict) or set(table) != {"paths"} or not table["paths"]:
        raise _invalid_key(path, "studies", '[studies] with paths = ["rigs/*/study.toml", ...]')
    if not _is_list_of_text(table["paths"]):
        raise _invalid_key(path, "studies.paths", "a list of paths, folders, globs or URLs")
    return _collect_studies([resolved(item, str(path)) for item in table["paths"]])


def _is_list_of_text(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _invalid_key(path: Path, key: str, wanted: str) -> InvalidInput:
    return InvalidInput(f"'{key}' is missing or invalid", where=str(path), remedy=f"give {wanted}")
