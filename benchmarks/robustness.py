"""Robustness of campaigns on virtual arms: `python -m benchmarks.robustness STORE...`.

The store of `benchmarks.families` has true values and estimates. A *primary* parameter is an
inertia, a stiffness, a knee, Coulomb friction or gear damping. It is *accurate* if its error is at
most 1 % (damping: 5 %) or its 95 % interval contains the true value, and *wrong* if its error
exceeds 5 % and it is outside that interval. A wrong value in a run with the verdict "determined" is
a silent wrong answer.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from rich.table import Table
from scipy.stats import binomtest

from benchmarks.console import Console
from strainwave.fleet.campaign.store import read_parameters, read_runs

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
"""Group of a primary parameter by the beginning of its name."""
MAX_ERROR = 0.01  # relative error of an accurate value
MAX_DAMPING_ERROR = 0.05  # the same for gear damping
MIN_WRONG_ERROR = 0.05  # relative error of a wrong value
_PROMISED_OF = 1000  # runs
PROMISED: dict[Group, int] = {"clean": 2, "faulty": 10}
"""Largest promised number of silent wrong answers in 1,000 runs."""
OUTCOMES: tuple[Outcome, ...] = (
    *("named", "other code", "refused", "not determined", "harmless", "silent", "failed"),
)
_REFUSED = 2  # exit code


@dataclass(frozen=True, slots=True)
class Estimate:
    """A published primary parameter compared with its true value."""

    label: str
    kind: str
    error: float  # relative
    inside: bool  # whether the 95 % interval contains the true value

    @property
    def is_accurate(self) -> bool:
        """Whether its error is small or its interval contains the true value."""
        limit = MAX_DAMPING_ERROR if self.kind == "gear damping" else MAX_ERROR
        return self.inside or self.error <= limit

    @property
    def is_wrong(self) -> bool:
        """Whether its error is large and its interval excludes the true value."""
        return not self.inside and self.error > MIN_WRONG_ERROR


@dataclass(frozen=True, slots=True)
class Run:
    """One run with its primary parameters."""

    row: Row
    classes: Row
    estimates: tuple[Estimate, ...]

    @property
    def group(self) -> Group:
        """Properties drawn with the arm; unknown if its worker died."""
        if not self.classes:
            return "never opened"
        if self.classes.get("fault"):
            return "faulty"
        return "with an effect" if self.classes.get("effect") else "clean"

    @property
    def is_determined(self) -> bool:
        """Whether the verdict is "determined"."""
        return bool(self.row["status"] == "determined")

    @property
    def wrong(self) -> tuple[Estimate, ...]:
        """Wrong estimates."""
        return tuple(estimate for estimate in self.estimates if estimate.is_wrong)

    @property
    def is_silently_wrong(self) -> bool:
        """Whether the run is determined with a wrong estimate."""
        return self.is_determined and bool(self.wrong)

    @property
    def is_identified(self) -> bool:
        """Whether the run is determined and all estimates are accurate."""
        return self.is_determined and all(estimate.is_accurate for estimate in self.estimates)

    @property
    def outcome(self) -> Outcome:
        """How the run treats its fault."""
        if self.row["status"] == "failed":
            return "refused" if self.row["exit_code"] == _REFUSED else "failed"
        suspected = set(self.row["suspected"] or ())
        codes = set(self.classes.get("fault_codes", ()))
        if codes & (suspected | set(self.row["warnings"] or ())) or (suspected and not codes):
            return "named"
        if suspected:
            return "other code"
        if not self.is_determined:
            return "not determined"
        return "silent" if self.wrong else "harmless"


def kind_of(name: str) -> str | None:
    """Group of a parameter; None if it is not primary."""
    return next((kind for start, kind in KINDS.items() if name.startswith(start)), None)


def runs_of(rows: Iterable[Row], parameters: Iterable[Row]) -> list[Run]:
    """Runs of virtual arms with their estimates, from the two tables of a store.

    Repeated rows count once; runs of study files do not count.
    """
    parameters_of: dict[str, list[Row]] = defaultdict(list)
    for parameter in parameters:
        parameters_of[parameter["run"]].append(parameter)
    runs = {}
    for row in rows:
        of_run = parameters_of[row["run"]]
        estimates = [e for p in of_run if (e := _estimate(p, row)) is not None]
        has_true_values = any(p["true_value"] is not None for p in of_run)
        if has_true_values or row["classes"] or "#" in row["study"]:
            classes = json.loads(row["classes"]) if row["classes"] else {}
            runs[row["run"]] = Run(row, classes, tuple(estimates))
    return list(runs.values())


def _estimate(p: Row, row: Row) -> Estimate | None:
    """An identified primary parameter with a true value, else None."""
    kind, true = kind_of(p["name"]), p["true_value"]
    label = p["name"] if p["joint"] is None else f"{p['name']} {p['joint']}"
    has_value = p["value"] is not None and p["ci95_low"] is not None
    if kind is None or not true or not has_value or label not in (row["identified"] or ()):
        return None
    inside = bool(p["ci95_low"] <= true <= p["ci95_high"])
    return Estimate(label, kind, abs(p["value"] / true - 1.0), inside)


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % Wilson interval of a proportion."""
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def tables(runs: Sequence[Run]) -> list[Table]:
    """Verdicts, coverage, faults and silent wrong answers, by drawn property."""
    groups = [group for group in get_args(Group) if any(run.group == group for run in runs)]
    summaries = [_verdicts(runs, groups), _coverage(runs, groups)]
    if "faulty" in groups:
        summaries.append(_faults([run for run in runs if run.group == "faulty"]))
    return [*summaries, _silent(runs, groups)]


def _verdicts(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    table = Table("arms", "runs", "determined %", "determined and accurate %", "s", box=None)
    for group in groups:
        in_group = [run for run in runs if run.group == group]
        seconds = np.median([run.row["seconds"] for run in in_group])
        determined = _percent(run.is_determined for run in in_group)
        identified = _percent(run.is_identified for run in in_group)
        table.add_row(group, str(len(in_group)), determined, identified, f"{seconds:.1f}")
    return table


def _coverage(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = ("intervals", "inside %", "accurate %", "median error %")
    table = Table("arms", "parameters", *columns, box=None, title="published")
    for group in groups:
        for kind in dict.fromkeys(KINDS.values()):
            estimates = [
                e for run in runs if run.group == group for e in run.estimates if e.kind == kind
            ]
            if estimates:
                inside = _percent(e.inside for e in estimates)
                accurate = _percent(e.is_accurate for e in estimates)
                median = f"{100.0 * np.median([e.error for e in estimates]):.2g}"
                table.add_row(group, kind, str(len(estimates)), inside, accurate, median)
    return table


def _faults(runs: Sequence[Run]) -> Table:
    table = Table("fault", "runs", *OUTCOMES, box=None)
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for run in runs:
        kinds[run.classes["fault"]][run.outcome] += 1
        kinds["all"][run.outcome] += 1
    for kind in [*sorted(set(kinds) - {"all"}), "all"]:
        counts = [str(kinds[kind][outcome] or "") for outcome in OUTCOMES]
        table.add_row(kind, str(kinds[kind].total()), *counts)
    return table


def judge_promise(wrong: int, runs: int, promised: int) -> str:
    """Whether a promise per 1,000 runs is kept; fewer runs can only show that it is broken."""
    if runs < _PROMISED_OF:
        return "BROKEN" if 1e3 * wilson(wrong, runs)[0] > promised else "too few runs"
    return "kept" if 1e3 * wrong <= promised * runs else "BROKEN"


def _silent(runs: Sequence[Run], groups: Sequence[str]) -> Table:
    columns = ("runs", "wrong", "per 1,000", "95 % interval", "promised")
    table = Table("arms", *columns, "", box=None, title="SILENT WRONG ANSWERS")
    for group in groups:
        in_group = [run for run in runs if run.group == group]
        wrong = sum(run.is_silently_wrong for run in in_group)
        low, high = wilson(wrong, len(in_group))
        promised = next((most for name, most in PROMISED.items() if name == group), None)
        verdict = "" if promised is None else judge_promise(wrong, len(in_group), promised)
        promise = "" if promised is None else f"at most {promised}"
        interval = f"{1e3 * low:.2g} to {1e3 * high:.2g}"
        rate = f"{1e3 * wrong / len(in_group):.2g}"
        table.add_row(group, str(len(in_group)), str(wrong), rate, interval, promise, verdict)
    return table


def _percent(flags: Iterable[bool]) -> str:
    values = list(flags)
    return f"{100.0 * np.mean(values):.1f}" if values else ""


def main() -> None:
    """Print the tables of stores, and each silent wrong answer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stores", nargs="+", metavar="STORE")
    options = parser.parse_args()
    rows: list[Row] = []
    parameters: list[Row] = []
    for store in options.stores:
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
            errors = ", ".join(f"{e.label} error {100.0 * e.error:.1f} %" for e in run.wrong)
            drawn = run.classes.get("fault") or run.classes.get("effect") or "clean"
            console.print(f"{run.row['study']} ({drawn}): {errors}")


if __name__ == "__main__":
    main()
