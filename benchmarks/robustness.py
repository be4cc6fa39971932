"""Robustness figures of campaigns on virtual arms: `python -m benchmarks.robustness STORE...`.

A store of a campaign whose campaign.toml has a `[family]` holds true values beside estimates. A
*primary* parameter is an inertia, a stiffness, a knee, Coulomb friction or gear damping. It is
*within accuracy* up to 1 % off (damping: 5 %) or where its 95 % interval holds the truth, and
*wrong* where it is more than 5 % off and outside that interval. A wrong one that is published in a
run with the verdict "determined" is a silent wrong answer.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from strainwave.campaign.store import read_parameters, read_runs

Row = dict[str, Any]
Group = Literal["clean", "faulty", "with an effect", "never opened"]
Outcome = Literal[
    "named", "other code", "refused", "not determined", "harmless", "silent", "failed"
]

KINDS = {
    "alpha": "inertias",
    "beta": "inertias",
    "gamma": "inertias",
    "inertia": "inertias",
    "motor_inertia": "inertias",
    "link_inertia": "inertias",
    "gear_stiffness": "stiffness",
    "gear_knee": "knees",
    "motor_coulomb_friction": "Coulomb friction",
    "gear_damping": "gear damping",
}
"""What primary parameters are counted under, by how their names begin."""
ACCURACY = {"gear damping": 0.05}  # of a value; of all others 1 %
WRONG = 0.05
_PROMISED_OF = 1000  # runs
PROMISED: dict[Group, int] = {"clean": 2, "faulty": 10}
"""Silent wrong answers in 1,000 runs, at most."""
OUTCOMES: tuple[Outcome, ...] = (
    *("named", "other code", "refused", "not determined", "harmless", "silent", "failed"),
)
_REFUSED = 2  # exit code


@dataclass(frozen=True, slots=True)
class Estimate:
    """A primary parameter that was published, against its true value."""

    label: str
    kind: str
    error: float  # of the true value
    inside: bool  # the 95 % interval

    @property
    def is_accurate(self) -> bool:
        """Whether it is near the truth or its interval holds it."""
        return self.inside or self.error <= ACCURACY.get(self.kind, 0.01)

    @property
    def is_wrong(self) -> bool:
        """Whether it is far from the truth, and its interval denies it."""
        return not self.inside and self.error > WRONG


@dataclass(frozen=True, slots=True)
class Run:
    """A row of the runs, with its primary parameters."""

    row: Row
    classes: Row
    estimates: tuple[Estimate, ...]

    @property
    def group(self) -> Group:
        """What was drawn beside the arm; unknown where its worker was ended."""
        if not self.classes:
            return "never opened"
        if self.classes.get("fault"):
            return "faulty"
        return "with an effect" if self.classes.get("effect") else "clean"

    @property
    def is_determined(self) -> bool:
        """Whether the verdict stands behind every parameter."""
        return bool(self.row["status"] == "determined")

    @property
    def wrong(self) -> tuple[Estimate, ...]:
        """What is published and wrong."""
        return tuple(each for each in self.estimates if each.is_wrong)

    @property
    def is_silently_wrong(self) -> bool:
        """Whether a published parameter of a determined arm is wrong."""
        return self.is_determined and bool(self.wrong)

    @property
    def is_identified(self) -> bool:
        """Whether the arm is determined and all of it within accuracy."""
        return self.is_determined and all(each.is_accurate for each in self.estimates)

    @property
    def outcome(self) -> Outcome:
        """What became of a fault."""
        if self.row["status"] == "failed":
            return "refused" if self.row["exit_code"] == _REFUSED else "failed"
        suspected = set(self.row["suspected"] or ())
        own = set(self.classes.get("fault_codes", ()))
        if own & (suspected | set(self.row["warnings"] or ())) or (suspected and not own):
            return "named"
        if suspected:
            return "other code"
        if not self.is_determined:
            return "not determined"
        return "silent" if self.wrong else "harmless"


def kind_of(name: str) -> str | None:
    """What a parameter is counted under; None where it is not primary."""
    return next((kind for start, kind in KINDS.items() if name.startswith(start)), None)


def runs_of(rows: Iterable[Row], parameters: Iterable[Row]) -> list[Run]:
    """Runs of virtual arms with what they published.

    Parameters
    ----------
    rows, parameters : iterable of dict
        Of a store's tables.

    Returns
    -------
    list of Run
        Each once, without those of study files.
    """
    own: dict[str, list[Row]] = defaultdict(list)
    for parameter in parameters:
        own[parameter["run"]].append(parameter)
    found = {}
    for row in rows:
        estimates = [each for p in own[row["run"]] if (each := _estimate(p, row)) is not None]
        known = any(p["true_value"] is not None for p in own[row["run"]])
        if known or row["classes"] or "#" in row["study"]:
            classes = json.loads(row["classes"]) if row["classes"] else {}
            found[row["run"]] = Run(row, classes, tuple(estimates))
    return list(found.values())


def _estimate(p: Row, row: Row) -> Estimate | None:
    """A primary parameter that the run calls identified; None: another, or none has a truth."""
    kind, true = kind_of(p["name"]), p["true_value"]
    label = p["name"] if p["joint"] is None else f"{p['name']} {p['joint']}"
    given = p["value"] is not None and p["ci95_low"] is not None
    if kind is None or not true or not given or label not in (row["identified"] or ()):
        return None
    inside = bool(p["ci95_low"] <= true <= p["ci95_high"])
    return Estimate(label, kind, abs(p["value"] / true - 1.0), inside)


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % interval of a share."""
    found = binomtest(count, total).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def tables(runs: Sequence[Run]) -> list[Table]:
    """Verdicts, coverage, faults and silent wrong answers, by what was drawn."""
    groups = [group for group in get_args(Group) if any(run.group == group for run in runs)]
    found = [_verdicts(runs, groups), _coverage(runs, groups)]
    if "faulty" in groups:
        found.append(_faults([run for run in runs if run.group == "faulty"]))
    return [*found, _silent(runs, groups)]


def _verdicts(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    table = Table("arms", "runs", "determined %", "identified within accuracy %", "s", box=None)
    for group in groups:
        own = [run for run in runs if run.group == group]
        seconds = np.median([run.row["seconds"] for run in own])
        shares = [_share(run.is_determined for run in own), _share(r.is_identified for r in own)]
        table.add_row(group, str(len(own)), *shares, f"{seconds:.1f}")
    return table


def _coverage(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = ("intervals", "inside %", "within accuracy %", "median error %")
    table = Table("arms", "parameters", *columns, box=None, title="published")
    for group in groups:
        for kind in dict.fromkeys(KINDS.values()):
            own = [e for r in runs if r.group == group for e in r.estimates if e.kind == kind]
            if own:
                shares = [_share(e.inside for e in own), _share(e.is_accurate for e in own)]
                median = f"{100.0 * np.median([e.error for e in own]):.2g}"
                table.add_row(group, kind, str(len(own)), *shares, median)
    return table


def _faults(runs: Sequence[Run]) -> Table:
    table = Table("fault", "runs", *OUTCOMES, box=None)
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for run in runs:
        kinds[run.classes["fault"]][run.outcome] += 1
        kinds["all"][run.outcome] += 1
    for kind in [*sorted(set(kinds) - {"all"}), "all"]:
        counts = [str(kinds[kind][each] or "") for each in OUTCOMES]
        table.add_row(kind, str(kinds[kind].total()), *counts)
    return table


def said_of(wrong: int, runs: int, most: int) -> str:
    """Whether a promise of so many in 1,000 is kept; of fewer runs no more than that it is not."""
    if runs < _PROMISED_OF:
        return "BROKEN" if 1e3 * wilson(wrong, runs)[0] > most else "too few runs"
    return "kept" if 1e3 * wrong <= most * runs else "BROKEN"


def _silent(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = ("runs", "wrong", "in 1,000", "95 % interval", "promised")
    table = Table("arms", *columns, "", box=None, title="SILENT WRONG ANSWERS")
    for group in groups:
        own = [run for run in runs if run.group == group]
        wrong = sum(run.is_silently_wrong for run in own)
        low, high = wilson(wrong, len(own))
        most = next((most for name, most in PROMISED.items() if name == group), None)
        said = "" if most is None else said_of(wrong, len(own), most)
        promised = "" if most is None else f"at most {most}"
        interval = f"{1e3 * low:.2g} to {1e3 * high:.2g}"
        share = f"{1e3 * wrong / len(own):.2g}"
        table.add_row(group, str(len(own)), str(wrong), share, interval, promised, said)
    return table


def _share(of: Iterable[bool]) -> str:
    found = list(of)
    return f"{100.0 * np.mean(found):.1f}" if found else ""


def main() -> None:
    """Print the tables of stores, and each silent wrong answer by name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stores", nargs="+", metavar="STORE")
    chosen = parser.parse_args()
    rows: list[Row] = []
    parameters: list[Row] = []
    for store in chosen.stores:
        rows += read_runs(store).to_pylist()
        parameters += read_parameters(store).to_pylist()
    runs = runs_of(rows, parameters)
    if not runs:
        parser.error("no run of a virtual arm in these stores")
    console = Console(width=160)
    for table in tables(runs):
        console.print(table)
    for run in runs:
        if run.is_silently_wrong:
            said = ", ".join(f"{e.label} {100.0 * e.error:.1f} % off" for e in run.wrong)
            drawn = run.classes.get("fault") or run.classes.get("effect") or "clean"
            console.print(f"{run.row['study']} ({drawn}): {said}")


if __name__ == "__main__":
    main()
