"""How often 95 % intervals hold the truth: `python -m benchmarks.studies.coverage --arms 500`.

Every arm goes through the whole of `identify`, from logs to the whole-arm fit. With `--catalogue`
arms are drawn over a gear catalogue, and counted by class, for the whole-arm fit and for the
decoupled stage; `--engine` lets MuJoCo move them.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies.arms import each, rig, with_logs
from strainwave.domain import Parameter
from strainwave.domain.parameters import Values
from strainwave.dynamics.simulation import simulate
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived
from strainwave.virtual.families.catalogue import drawn as of_catalogue
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.records import Simulator

EXACT_STEP = 4e-6
"""[s] Of a truth: at 300 Hz the sensors' filters are wrong by 5e-6, below any deviation."""
_NOMINAL = {"scale": 1.0}  # of link sensors; a delay is zero, and so is what was not drawn
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
"""What parameters are counted under, by what their names hold; the first that fits."""
OF_THE_ENGINE = "friction_settling_time"  # one or two of its steps, which no parameter says


def tried(path: Path, values: Values, *, engine: bool = False) -> dict[str, Any]:
    """Errors in deviations, relative deviations and coverage of every parameter.

    How long an engine's friction takes to stop a motor is no parameter, and is left out.
    """
    identification = identify(path)
    tuned = identification.tuned
    if tuned is None:
        suspected = [one.code for one in identification.suspected]
        return {"failure": f"no whole-arm fit; suspected: {suspected}"}
    known = derived(values, read_study(path).arm)
    left_out = [
        [name, joint]
        for (name, joint), true in values.items()
        if name == "friction_settling_time" and true and tuned.values.get((name, joint)) == 0.0
    ]
    decoupled = [p for joint in identification.joints for p in joint.parameters]
    return {
        "status": tuned.status,
        "parameters": rows_of(
            [p for p in tuned.parameters if not (engine and p.name == OF_THE_ENGINE)], known
        ),
        "decoupled": rows_of([p for p in decoupled if (p.name, p.joint) in known], known),
        "left_out": left_out,
    }


def rows_of(parameters: Sequence[Parameter], known: Values) -> list[list[Any]]:
    """Name, joint, error and deviation, and whether the interval holds the truth, of each.

    One stiffness for a curve has no truth.
    """
    rows: list[list[Any]] = []
    for p in parameters:
        true = known.get((p.name, p.joint), _NOMINAL.get(p.name.rsplit("_", 1)[-1], 0.0))
        if p.value is None or p.std is None or p.ci95 is None:
            rows.append([p.name, p.joint, None, None, None])
            continue
        size = abs(true) or 1.0
        inside = bool(p.ci95[0] <= true <= p.ci95[1])
        rows.append([p.name, p.joint, (p.value - true) / p.std, p.std / size, inside])
    return rows


def by_class(found: Sequence[dict[str, Any]], key: str) -> Table:
    """Shares of intervals that hold the truth, by kinds of parameters and classes of arms."""
    held: dict[tuple[str, str], list[bool]] = defaultdict(list)
    arms: dict[tuple[str, str], int] = defaultdict(int)
    for one in found:
        for place in [("all", ""), *one["classes"].items()]:
            held[place] += [row[4] for row in one[key] if row[4] is not None]
            arms[place] += 1
        kinds = {kind_of(row[0]) for row in one[key]}
        for kind in kinds:
            of_kind = [row for row in one[key] if kind_of(row[0]) == kind]
            held["parameter", kind] += [row[4] for row in of_kind if row[4] is not None]
            arms["parameter", kind] += 1
    table = Table("class", "", "arms", "intervals", "inside %", box=None, title=key)
    for (kind, name), inside in sorted(held.items()):
        share = f"{100.0 * np.mean(inside):.1f}" if inside else ""
        table.add_row(kind, name, str(arms[kind, name]), str(len(inside)), share)
    return table


def kind_of(name: str) -> str:
    """What a parameter is counted under."""
    return next((kind for part, kind in _KINDS.items() if part in name), "link sensors")


def drawn_rig(seed: int, series: int, *, catalogue: bool) -> Rig:
    """The arm of a seed: of the catalogue, or one like the built-in rig's."""
    return of_catalogue(seed, series) if catalogue else rig(seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=500)
    parser.add_argument("--catalogue", action="store_true", help="arms over a gear catalogue")
    parser.add_argument("--seed", type=int, default=0, help="of the catalogue's series of arms")
    parser.add_argument("--engine", action="store_true", help="let MuJoCo move the arms")
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    by_name: dict[str, list[list[Any]]] = defaultdict(list)
    failures: list[dict[str, Any]] = []
    statuses: dict[str, int] = defaultdict(int)
    simulator: Simulator = partial(simulate, longest=EXACT_STEP)
    if chosen.engine:
        from benchmarks.studies.engine import in_mujoco as simulator
    arm = partial(drawn_rig, series=chosen.seed, catalogue=chosen.catalogue)
    errors = partial(tried, engine=chosen.engine)
    work = partial(with_logs, work=errors, arm=arm, simulator=simulator)
    answered = []
    for found in each(chosen.arms, work, chosen.out):
        if "failure" in found:
            failures.append(found)
            continue
        answered.append(found)
        statuses[found["status"]] += 1
        for name, joint, *row in found["parameters"]:
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
        console.print(by_class(answered, key))
    console.print(f"{dict(statuses)}, {len(failures)} failures")
    for failure in failures:
        console.print(f"arm {failure['seed']}: {failure['failure']}")


if __name__ == "__main__":
    main()
