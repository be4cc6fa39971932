"""Overview of the signals of a log, on page "Study": also of a draft whose values are missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from starlette.requests import Request
from tomlkit import TOMLDocument

from strainwave.domain import channel_names
from strainwave.errors import InvalidInput
from strainwave.init.changes import columns_of, read_draft, table_of, tables_of
from strainwave.io.kept_files import cached, stamp_of
from strainwave.io.logs.columns import open_log, read_columns
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures.outlines import Outline, outline
from strainwave.workbench.web import Routes, study_file_of, workspace_of

T = TypeVar("T")

routes = Routes()
_COLUMN_BYTES = 4 << 10  # of an outline


def column_names(path: Path) -> list[str]:
    """Names of the columns of a log; raises InvalidInput if it cannot be read."""
    return _kept("names", path, lambda: list(open_log(path).names))


def outlines(path: Path) -> dict[str, Outline]:
    """The outline of each column of a log; a few columns are in memory at a time."""
    return _kept("outlines", path, lambda: {k: outline(v) for k, v in read_columns(path)})


def _kept(what: str, path: Path, read: Callable[[], T]) -> T:
    """What is read of a log, until the log changes."""
    if not path.exists():
        raise InvalidInput("the log does not exist", where=str(path), remedy="choose another file")
    kept: T = cached((what, stamp_of(path)), read, lambda each: _COLUMN_BYTES * len(each))
    return kept


def log_path(request: Request, record: Mapping[str, Any]) -> Path:
    """The log of an experiment of the study that the address names."""
    return workspace_of(request).file_of(study_file_of(request), str(record.get("file")))


def columns_by_record(request: Request, document: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names of the columns of each experiment; none if its log cannot be read."""
    columns: dict[str, list[str]] = {}
    for record in tables_of(document, "experiment"):
        columns[str(record.get("name"))] = names = []
        with suppress(InvalidInput):
            names += column_names(log_path(request, record))
    return columns


def named_record(request: Request) -> tuple[TOMLDocument, Mapping[str, Any]]:
    """The study that the address names, and its `experiment`."""
    path, wanted = study_file_of(request), request.query_params.get("experiment")
    document = read_draft(path)
    for record in tables_of(document, "experiment"):
        if record.get("name") == wanted:
            return document, record
    raise InvalidInput("there is no such experiment", where=path.name)


@routes.get("/api/overview/{study:path}")
def overview(request: Request) -> object:
    """The columns of a record as outlines: those of channels first, in SI units."""
    document, record = named_record(request)
    lines = dict(outlines(log_path(request, record)))
    mapped = table_of(document, "channels")
    channels = channel_names(len(tables_of(document, "joint")))
    rows = [
        _row(column, lines.pop(column), channel, mapped.get(channel, channel))
        for channel in channels
        for column in columns_of(mapped.get(channel, channel))
        if column in lines
    ]
    clock = [row for row in rows if row["channel"] == "t" and row["unit"]]
    seconds = clock[0]["high"] - clock[0]["low"] if len(clock) == 1 else None
    rows += [_row(column, line) for column, line in lines.items()]
    return {"file": record.get("file"), "seconds": seconds, "rows": rows}


def _row(column: str, line: Outline, channel: str = "", entry: object = None) -> dict[str, Any]:
    """A column with its channel, in SI units if its `entry` in [channels] has numbers."""
    table = entry if isinstance(entry, Mapping) else {}
    scale, offset = table.get("scale", 1.0), table.get("offset", 0.0)
    unit = unit_of(channel)
    if not isinstance(scale, int | float) or not isinstance(offset, int | float):
        scale, offset, unit = 1.0, 0.0, ""
    low, high = sorted((scale * line.low + offset, scale * line.high + offset))
    row = {"column": column, "channel": channel, "unit": unit, "is_reversed": scale < 0}
    return asdict(line) | row | {"low": low, "high": high}
