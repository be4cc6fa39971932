"""Console of the benchmarks: it prints, and writes the printed tables as JSON for `claims`."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich import console
from rich.table import Table
from rich.text import Text

TABLES_VARIABLE = "STRAINWAVE_BENCHMARK_TABLES"
"""Environment variable with the path of a file to which each table is added, a line of JSON."""


class Console(console.Console):
    """Console that also writes the tables which it prints to the file of `TABLES_VARIABLE`."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does."""
        super().print(*objects, **options)
        path = os.environ.get(TABLES_VARIABLE)
        for table in objects:
            if path and isinstance(table, Table):
                with Path(path).open("a", encoding="utf-8") as file:
                    file.write(json.dumps(_content(table)) + "\n")


def share_of(inside: Sequence[bool]) -> str:
    """Share of intervals that contain the true value, as "97.4 % of 993"."""
    return f"{100.0 * sum(inside) / len(inside):.1f} % of {len(inside)}" if inside else ""


def _content(table: Table) -> dict[str, Any]:
    """Title, heads and rows of a table as plain text."""
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    return {
        "title": _plain(table.title or ""),
        "heads": [_plain(column.header) for column in table.columns],
        "rows": [list(row) for row in zip(*columns, strict=True)],
    }


def _plain(cell: Any) -> str:
    return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell)
