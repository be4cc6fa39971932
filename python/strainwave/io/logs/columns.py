"""Columns of a log by name, of a table or a bag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from strainwave.domain import FloatArray
from strainwave.io.logs.bags import Bag, is_bag
from strainwave.io.logs.tables import LogTable, open_table, release_reader_memory

_MAX_BATCH_BYTES = 256 << 20  # of columns in memory at a time


def open_log(path: Path) -> LogTable | Bag:
    """The columns of a log; raises InvalidInput if it cannot be read."""
    return Bag(path) if is_bag(path) else open_table(path)


def read_columns(
    path: Path, names: Sequence[str] | None = None
) -> Iterator[tuple[str, FloatArray]]:
    """Some or all columns of a log, each (n_samples,); a few of a table are in memory at a time.

    Raises InvalidInput if the log lacks one of them.
    """
    log = open_log(path)
    rest = list(log.names if names is None else names)
    for name in rest:
        if name not in log.names:
            raise log.missing_column_error(name, "which the channel needs")
    if isinstance(log, Bag):
        for track in log.tracks(rest)[0] if rest else ():
            yield from track.columns.items()
        return
    size = 1
    while rest:
        batch, rest = rest[:size], rest[size:]
        columns = log.read(batch)
        yield from columns.items()
        size = max(1, _MAX_BATCH_BYTES // max(v.nbytes for v in columns.values()))
        del columns
    release_reader_memory()
