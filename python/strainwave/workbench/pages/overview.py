"""Overview of the signals of a log, on page "Study": also of a draft whose values are missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from starlette.requests import Request

from strainwave.domain import FloatArray, channel_names
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_bytes
from strainwave.io.kept_files import cached, stamp_of
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.tables import open_table, release_reader_memory
from strainwave.report.document.predictions import unit_of
from strainwave.workbench.study_edit import columns_of, parse_draft, table_of, tables_of
from strainwave.workbench.web import Routes, study_file_of, workspace_of

T = TypeVar("T")

routes = Routes()
WIDTH, HEIGHT = 240, 100  # of the view of a line; a bin is one unit wide
_COLUMN_BYTES = 4 << 10  # of an outline
_MAX_BATCH_BYTES = 256 << 20  # of columns in memory at a time


@dataclass(frozen=True, slots=True)
class Outline:
    """A column of a log as lowest and highest value of each bin."""

    samples: int
    low: float  # NaN if it has no number
    high: float
    points: str  # of an SVG polyline in WIDTH x HEIGHT


def column_names(path: Path) -> list[str]:
    """Names of the columns of a log; raises InvalidInput if it cannot be read."""

    def read() -> list[str]:
        return list((Bag(path) if is_bag(path) else open_table(path)).names)

    return _kept("names", path, read)


def outline(values: FloatArray) -> Outline:
    """The outline of a column (n_samples,); missing and infinite values are left out."""
    finite = np.where(np.isfinite(values), values, np.nan)
    edges = np.unique(np.linspace(0, len(values), WIDTH + 1)[:-1].astype(int))
    low, high = np.fmin.reduceat(finite, edges), np.fmax.reduceat(finite, edges)
    rows = np.flatnonzero(np.isfinite(low))
    if not len(rows):
        return Outline(len(values), np.nan, np.nan, "")
    bottom, top = float(low[rows].min()), float(high[rows].max())
    scale = HEIGHT / (top - bottom) if top > bottom else 0.0
    x = edges[rows] * WIDTH / len(values)
    lower, upper = ((HEIGHT - scale * (each[rows] - bottom)) for each in (low, high))
    if not scale:
        lower = upper = np.full(len(rows), HEIGHT / 2)
    points = np.column_stack([x, lower, x, upper]).reshape(-1, 2).round(1)
    return Outline(len(values), bottom, top, " ".join(f"{a:g},{b:g}" for a, b in points))


def outlines(path: Path) -> dict[str, Outline]:
    """The outline of each column of a log; a few columns are in memory at a time."""

    def read() -> dict[str, Outline]:
        return {name: outline(values) for name, values in _columns(path)}

    return _kept("outlines", path, read)


def _kept(what: str, path: Path, read: Callable[[], T]) -> T:
    """What is read of a log, until the log changes."""
    if not path.exists():
        raise InvalidInput("the log does not exist", where=str(path), remedy="choose another file")
    kept: T = cached((what, stamp_of(path)), read, lambda each: _COLUMN_BYTES * len(each))
    return kept


def _columns(path: Path) -> Iterator[tuple[str, FloatArray]]:
    if is_bag(path):
        bag = Bag(path)
        for track in bag.tracks(bag.names)[0] if bag.names else ():
            yield from track.columns.items()
        return
    table = open_table(path)
    size = 1
    rest = list(table.names)
    while rest:
        names, rest = rest[:size], rest[size:]
        columns = table.read(names)
        yield from columns.items()
        size = max(1, _MAX_BATCH_BYTES // max(v.nbytes for v in columns.values()))
        del columns
    release_reader_memory()


@routes.get("/api/overview/{study:path}")
def overview(request: Request) -> object:
    """The columns of a record as outlines: those of channels first, in SI units."""
    path, wanted = study_file_of(request), request.query_params.get("experiment")
    document = parse_draft(decode(read_bytes(path, "the study file"), path), path).unwrap()
    files = [e.get("file") for e in tables_of(document, "experiment") if e.get("name") == wanted]
    if not files:
        raise InvalidInput("there is no such experiment", where=path.name)
    lines = dict(outlines(workspace_of(request).file_of(path, str(files[0]))))
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
    return {"file": files[0], "seconds": seconds, "rows": rows}


def _row(column: str, line: Outline, channel: str = "", entry: object = None) -> dict[str, Any]:
    """A column with its channel, in SI units if its `entry` in [channels] has numbers."""
    table = entry if isinstance(entry, Mapping) else {}
    scale, offset = table.get("scale", 1.0), table.get("offset", 0.0)
    unit = "s" if channel == "t" else unit_of(channel)
    if not isinstance(scale, int | float) or not isinstance(offset, int | float):
        scale, offset, unit = 1.0, 0.0, ""
    low, high = sorted((scale * line.low + offset, scale * line.high + offset))
    row = {"column": column, "channel": channel, "unit": unit, "is_reversed": scale < 0}
    return asdict(line) | row | {"low": low, "high": high}
