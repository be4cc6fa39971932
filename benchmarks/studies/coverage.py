"""Coverage of 95 % intervals: `python -m benchmarks.studies.coverage --arms 500`.

All stages of `identify` run on every drawn arm. `--catalogue` draws arms over a gear catalogue;
`--engine` simulates them in MuJoCo. Tables count intervals by parameter and by class of arm.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.families import catalogue as gear_catalogue
from benchmarks.families.rigs import Rig
from benchmarks.studies import arms
from benchmarks.studies.arms import run_all, run_on_logs
from strainwave.domain import Parameter
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import simulate
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import Simulator, derived

EXACT_STEP = 4e-6
"""Time step of the simulated logs [s].

The relative error of a sensor filter at 300 Hz is 5e-6, below any standard deviation.
"""
_NOMINAL = {"scale": 1.0}  # of link sensors; delays and parameters that are not drawn are zero
_KINDS = {
    "inertia": "inertias",
    "alpha": "inertias",
    "beta": "inertias",
    "gamma": "inertias",
    "gear_stiffness": "stiffness",
    "gear_knee": "knees",
    "gear_damping": "gear damping",
    "coulomb": "Coulomb friction",
    "total_viscous": "total viscous friction",
    "viscous": "split of viscous friction",
    "offset": "friction offset",
    "settling": "settling time",
}
"""Group of a parameter by a part of its name; the first match counts."""
ENGINE_PARAMETER = "friction_settling_time"  # MuJoCo has one or two of its steps, not this value


def evaluate(path: Path, values: Values, *, engine: bool = False) -> dict[str, Any]:
    """Normalised errors, relative standard deviations and coverage of every parameter.

    Friction settling times of MuJoCo are not counted.
    """
    identification = identify(path)
    whole_arm = identification.whole_arm
    if whole_arm is None:
        suspected = [suspicion.code for suspicion in identification.suspected]
        return {"failure": f"no whole-arm fit; suspected: {suspected}"}
    true_values = derived(values, read_study(path).arm)
    decoupled = [p for joint in identification.joints for p in joint.parameters]
    return {
        "status": whole_arm.status,
        "parameters": error_rows(
            [p for p in whole_arm.parameters if not (engine and p.name == ENGINE_PARAMETER)],
            true_values,
        ),
        "decoupled": error_rows(
            [p for p in decoupled if (p.name, p.joint) in true_values], true_values
        ),
    }


def error_rows(parameters: Sequence[Parameter], true_values: Values) -> list[list[Any]]:
    """Name, joint, error over std, relative std, and whether the interval has the true value."""
    rows: list[list[Any]] = []
    for p in parameters:
        true = true_values.get((p.name, p.joint), _NOMINAL.get(p.name.rsplit("_", 1)[-1], 0.0))
        if p.value is None or p.std is None or p.ci95 is None:
            rows.append([p.name, p.joint, None, None, None])
            continue
        size = abs(true) or 1.0
        inside = bool(p.ci95[0] <= true <= p.ci95[1])
        rows.append([p.name, p.joint, (p.value - true) / p.std, p.std / size, inside])
    return rows


def coverage_by_class(results: Sequence[dict[str, Any]], key: str) -> Table:
    """Coverage by kind of parameter and by class of arm."""
    coverage: dict[tuple[str, str], list[bool]] = defaultdict(list)
    n_arms: dict[tuple[str, str], int] = defaultdict(int)
    for result in results:
        for group in [("all", ""), *result["classes"].items()]:
            coverage[group] += [row[4] for row in result[key] if row[4] is not None]
            n_arms[group] += 1
        kinds = {parameter_kind(row[0]) for row in result[key]}
        for kind in kinds:
            rows = [row for row in result[key] if parameter_kind(row[0]) == kind]
            coverage["parameter", kind] += [row[4] for row in rows if row[4] is not None]
            n_arms["parameter", kind] += 1
    table = Table("class", "", "arms", "inside", box=None, title=key)
    for (kind, name), inside in sorted(coverage.items()):
        table.add_row(kind, name, str(n_arms[kind, name]), share_of(inside))
    return table


def parameter_kind(name: str) -> str:
    """Group of a parameter in the tables."""
    return next((kind for part, kind in _KINDS.items() if part in name), "link sensors")


def draw_rig(seed: int, series: int, *, catalogue: bool) -> Rig:
    """Draw an arm over the gear catalogue, or around the built-in arm."""
    return gear_catalogue.drawn(seed, series) if catalogue else arms.draw_rig(seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=500)
    parser.add_argument("--catalogue", action="store_true", help="arms over a gear catalogue")
    parser.add_argument("--seed", type=int, default=0, help="series of the catalogue's arms")
    parser.add_argument("--engine", action="store_true", help="simulate in MuJoCo")
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    options = parser.parse_args()
    by_name: dict[str, list[list[Any]]] = defaultdict(list)
    failures: list[dict[str, Any]] = []
    statuses: dict[str, int] = defaultdict(int)
    simulator: Simulator = partial(simulate, max_time_step=EXACT_STEP)
    if options.engine:
        from benchmarks.studies.engine import in_mujoco as simulator
    arm = partial(draw_rig, series=options.seed, catalogue=options.catalogue)
    errors = partial(evaluate, engine=options.engine)
    work = partial(run_on_logs, work=errors, arm=arm, simulator=simulator)
    results = []
    for result in run_all(range(options.arms), work, options.out):
        if "failure" in result:
            failures.append(result)
            continue
        results.append(result)
        statuses[result["status"]] += 1
        for name, joint, *row in result["parameters"]:
            by_name[name if joint is None else f"{name} {joint}"].append(row)
    table = Table("parameter", "identified", "inside %", "rms error/std", "median std %", box=None)
    for name, rows in by_name.items():
        reported = [row for row in rows if row[2] is not None]
        if reported:
            z, std, inside = (
                np.array(column, dtype=float) for column in zip(*reported, strict=True)
            )
            share, spread = f"{100.0 * np.mean(inside):.1f}", f"{np.sqrt(np.mean(z**2)):.2f}"
            table.add_row(name, str(len(reported)), share, spread, f"{100.0 * np.median(std):.3g}")
    console = Console()
    console.print(table)
    for key in ("parameters", "decoupled"):
        console.print(coverage_by_class(results, key))
    console.print(f"{dict(statuses)}, {len(failures)} failures")
    for failure in failures:
        console.print(f"arm {failure['seed']}: {failure['failure']}")


if __name__ == "__main__":
    main()
