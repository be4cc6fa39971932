"""Read tables in memory into float64 columns: pandas, polars, Arrow, or dictionaries of arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs.tables import Table

Data = Mapping[str, Any]
"""Name of an experiment -> its log: a table in memory, or the path of a file."""


def is_path(data: object) -> bool:
    """Whether data are a path instead of a table."""
    return isinstance(data, str | Path)


def table_of(data: Any, where: str) -> Table:
    """Open a table in memory: pandas, polars, Arrow, or a mapping of str to (n_samples,).

    `where` is the name for messages. Float64 columns are not copied. Raises InvalidInput if `data`
    is not a table; a column that is not a numeric vector raises when it is read.
    """
    names = _names(data)
    if names is None:
        raise InvalidInput(
            f"is no table, but {type(data).__name__}",
            where=where,
            remedy="give a pandas, polars or Arrow table, a dictionary of arrays, or a path",
        )
    for index, name in enumerate(names):
        if not isinstance(name, str) or name in names[:index]:
            problem = "is no text" if not isinstance(name, str) else "stands twice"
            raise InvalidInput(
                f"the column name {name!r} {problem}", where=where, remedy="rename the column"
            )

    def read(wanted: Sequence[str]) -> dict[str, FloatArray]:
        columns = {name: _vector(data[name], f"{where}, column {name!r}") for name in wanted}
        lengths = sorted({len(column) for column in columns.values()})
        if len(lengths) > 1:
            raise InvalidInput(
                f"the columns differ in length: {lengths}",
                where=where,
                remedy="give all channels at the same instants",
            )
        return columns

    return Table(names, read)


def _names(data: Any) -> list[Any] | None:
    if isinstance(data, Mapping):
        return list(data)
    for attribute in ("column_names", "columns"):  # Arrow's `columns` are the arrays themselves
        names = getattr(data, attribute, None)
        if names is not None and not callable(names):
            return list(names)
    return None


def _vector(column: Any, where: str) -> FloatArray:
    try:
        values = np.asarray(column)
    except (TypeError, ValueError):
        values = np.empty(0, dtype=object)
    if values.ndim != 1 or values.dtype.kind not in "fiu":
        raise InvalidInput(
            f"is no vector of numbers, but {values.dtype} of shape {values.shape}",
            where=where,
            remedy="give one number per sample",
        )
    return np.ascontiguousarray(values, dtype=np.float64)
