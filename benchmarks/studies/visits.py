"""Two visits to one arm, compared: `python -m benchmarks.studies.visits --arms 60`.

Catalogue arms are simulated twice with different motions and noise. All stages of `identify` run
on both visits, and `compare` tests them. Without a change, at most 5 % of the pairs may differ; a
change of joint 1 at the second visit (`--stiffness -2`, `--friction 10` [%]) should be named.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.families import catalogue
from benchmarks.families.catalogue import plans, with_short_records
from benchmarks.families.rigs import Rig
from benchmarks.studies.arms import run_all
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.fleet.monitoring.comparison import (
    DIFFERS,
    ResultEstimates,
    compare,
    estimates_of,
)
from strainwave.io.results import to_document
from strainwave.pipeline import identify
from strainwave.virtual.experiments import record_experiment

_SERIES = 9000  # of the catalogue
_VERTICAL_EVERY = 3  # arms
_LEVEL = 0.05  # probability of a false difference
_PARAMETER_PREFIXES = {"stiffness": "gear_stiffness", "friction": "motor_coulomb_friction"}

Changes = dict[str, float]


def compare_visits(number: int, *, changes: Changes) -> dict[str, Any]:
    """Simulate, identify and compare two visits to an arm."""
    rng = np.random.default_rng([2026, number])
    upright = number % _VERTICAL_EVERY == 0
    rig = with_short_records(catalogue.drawn(number, _SERIES), upright=upright, rng=rng)
    head: dict[str, Any] = {"seed": number, "spring": rig.study.arm.joints[0].spring}
    try:
        first = _visit(rig, rig.values, [number, 1])
        second = _visit(rig, _change_values(rig.values, changes), [number, 2])
    except (InvalidInput, NumericalFailure) as error:
        return head | {"failure": str(error)}
    result = compare([first, second], _LEVEL)
    pair, joint = result.pairs[0], result.pairs[0].joint
    return head | {
        "status": [first.status, second.status],
        "differs": result.differs,
        "named": [p.first.label for p in pair.parameters if result.verdict(p) == DIFFERS],
        "p": [p.p for p in pair.parameters],
        "joint_p": joint.p if joint is not None else None,
    }


def _visit(rig: Rig, values: Values, seed: list[int]) -> ResultEstimates:
    """Simulate one visit and identify it."""
    arm = Arm.of(rig.study.arm)
    logs = {}
    motions = int(np.random.default_rng(seed).integers(2**31))
    for k, (experiment, plan) in enumerate(
        zip(rig.study.experiments, plans(rig, motions), strict=True)
    ):
        rng = np.random.default_rng([*seed, k])
        logs[experiment.name] = record_experiment(
            rig.study, arm, plan, values, rig.noise, rng, simulate, experiment.name
        )
    return estimates_of(to_document(identify(rig.study, data=logs, threads=1)), Path(f"{seed}"))


def _change_values(values: Values, changes: Changes) -> Values:
    factors = {
        _PARAMETER_PREFIXES[quantity]: 1.0 + percent / 100.0
        for quantity, percent in changes.items()
    }
    return {
        (name, joint): value
        * next((f for start, f in factors.items() if joint == 1 and name.startswith(start)), 1.0)
        for (name, joint), value in values.items()
    }


def main() -> None:
    """Print how often two visits differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=60)
    parser.add_argument("--at-once", type=int)
    for quantity in _PARAMETER_PREFIXES:
        parser.add_argument(f"--{quantity}", type=float, default=0.0, help="change of joint 1 [%%]")
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    options = parser.parse_args()
    changes = {
        quantity: getattr(options, quantity)
        for quantity in _PARAMETER_PREFIXES
        if getattr(options, quantity)
    }
    work = partial(compare_visits, changes=changes)
    results = list(run_all(range(options.arms), work, options.out, options.at_once))
    Console(width=120).print(_summary(results, changes))


def _summary(results: list[dict[str, Any]], changes: Changes) -> Table:
    table = Table(box=None, title=f"Two visits, changes: {changes or 'none'}")
    for head in ("both visits", "pairs", "differ", "change named", "p below 5 %", "joint"):
        table.add_column(head)
    starts = tuple(_PARAMETER_PREFIXES[quantity] for quantity in changes)
    pairs = [result for result in results if "failure" not in result]
    determined = [pair for pair in pairs if set(pair["status"]) == {"determined"}]
    for title, group in (("determined", determined), ("of any status", pairs)):
        p = np.array([value for pair in group for value in pair["p"]])
        joint = np.array([pair["joint_p"] for pair in group if pair["joint_p"] is not None])
        named = sum(any(n.startswith(starts) for n in pair["named"]) for pair in group)
        table.add_row(
            title,
            str(len(group)),
            str(sum(pair["differs"] for pair in group)),
            str(named) if starts else "",
            f"{100.0 * np.mean(p < _LEVEL):.1f} % of {len(p)}" if len(p) else "",
            f"{100.0 * np.mean(joint < _LEVEL):.1f} % of {len(joint)}" if len(joint) else "",
        )
    return table


if __name__ == "__main__":
    main()
