"""Read tables in memory into float64 columns: pandas, polars, Arrow, or dictionaries of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput
from strainwave.io.logs.tables import Table, check_unique

Data = Mapping[str, Any]
"""Name of an experiment -> its log: a table in memory, or the path of a file."""


def open_memory_table(data: Any, where: str) -> Table:
    """Open a table in memory: pandas, polars, Arrow, or a mapping of str to arrays.

    `where` is the name for messages. Float64 columns are not copied. Raises InvalidInput if `data`
    is not a table or contains no numbers.
    """
    from strainwave.io.logs.arrays import Arrays, array_table

    names = _names(data)
    if names is None:
        raise InvalidInput(
            f"is not a table, but {type(data).__name__}",
            where=where,
            remedy="pass a pandas, polars or Arrow table, a dictionary of arrays, or a path",
        )
    for name in names:
        if not isinstance(name, str):
            raise InvalidInput(
                f"the column name {name!r} is not a string", where=where, remedy="rename the column"
            )
    check_unique(names, where)
    arrays = Arrays()
    for name in names:
        arrays.add(name, data[name])
    return array_table(Path(where), arrays, row="row")


def _names(data: Any) -> list[Any] | None:
    if isinstance(data, Mapping):
        return list(data)
    for attribute in ("column_names", "columns"):  # Arrow's `columns` are the arrays themselves
        names = getattr(data, attribute, None)
        if names is not None and not callable(names):
            return list(names)
    return None
