"""How often 95 % intervals hold the truth: `python -m benchmarks.studies.coverage --arms 500`.

Every arm goes through the whole of `identify`, from logs to the whole-arm fit.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies.arms import each, with_logs
from strainwave.parameters import Values
from strainwave.pipeline import identify
from strainwave.study import read_study
from strainwave.virtual import derived


def tried(path: Path, values: Values) -> dict[str, Any]:
    """Errors in deviations, relative deviations and coverage of every parameter."""
    identification = identify(path)
    tuned = identification.tuned
    if tuned is None:
        return {"failure": identification.reason}
    known = derived(values, read_study(path))
    rows: list[list[Any]] = []
    for p in tuned.parameters:
        true = known.get((p.name, p.joint), 0.0)
        if p.value is None or p.std is None or p.ci95 is None:
            rows.append([p.name, p.joint, None, None, None])
            continue
        size = abs(true) or 1.0
        inside = p.ci95[0] <= true <= p.ci95[1]
        rows.append([p.name, p.joint, (p.value - true) / p.std, p.std / size, inside])
    left_out = [
        [name, joint]
        for (name, joint), true in values.items()
        if name == "friction_settling_time" and true and tuned.values.get((name, joint)) == 0.0
    ]
    return {"status": tuned.status, "parameters": rows, "left_out": left_out}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=500)
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    by_name: dict[str, list[list[Any]]] = defaultdict(list)
    failures: list[dict[str, Any]] = []
    statuses: dict[str, int] = defaultdict(int)
    for found in each(chosen.arms, partial(with_logs, work=tried), chosen.out):
        if "failure" in found:
            failures.append(found)
            continue
        statuses[found["status"]] += 1
        for name, joint, *row in found["parameters"]:
            by_name[name if joint is None else f"{name} {joint}"].append(row)
    table = Table("parameter", "told", "inside %", "rms error/std", "median std %", box=None)
    for name, rows in by_name.items():
        told = [row for row in rows if row[2] is not None]
        if told:
            z, std, inside = (np.array(column, dtype=float) for column in zip(*told, strict=True))
            share, spread = f"{100.0 * np.mean(inside):.1f}", f"{np.sqrt(np.mean(z**2)):.2f}"
            table.add_row(name, str(len(told)), share, spread, f"{100.0 * np.median(std):.3g}")
    console = Console()
    console.print(table)
    console.print(f"{dict(statuses)}, {len(failures)} failures")
    for failure in failures:
        console.print(f"arm {failure['seed']}: {failure['failure']}")


if __name__ == "__main__":
    main()
