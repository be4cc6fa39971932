"""Run all benchmarks, or the named ones, and print one table.

python -m benchmarks [arm] [chain] [factor] [length] [payload] [read] [rigid] [servo] [statespace]
    [tuning] [workbench]
"""

from __future__ import annotations

import importlib
import pkgutil
import sys

from rich.table import Table

import benchmarks
from benchmarks.console import Console
from benchmarks.timing import Row


def main() -> None:
    table = Table(
        "task",
        "time",
        "peer",
        "peer time",
        "ratio",
        "error",
        "peer error",
        box=None,
        pad_edge=False,
    )
    for column in table.columns[1:]:
        column.justify = "right"
    for module in sorted(m.name for m in pkgutil.iter_modules(benchmarks.__path__)):
        if module.startswith("bench_") and module[6:] in (sys.argv[1:] or [module[6:]]):
            rows: list[Row] = importlib.import_module(f"benchmarks.{module}").rows()
            for row in rows:
                table.add_row(*row.cells())
    Console().print(table)


if __name__ == "__main__":
    main()
