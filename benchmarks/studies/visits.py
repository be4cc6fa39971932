"""Two visits to one arm, compared: `python -m benchmarks.studies.visits --arms 60`.

Arms of the catalogue, on our own plant, are recorded twice with other motions and other noise,
both visits go through all of `identify`, and `compare` is asked whether they differ. Where nothing
changed, at most 5 % may be said to; a change of the second visit (`--stiffness -2`,
`--friction 10`, per cent of joint 1) should be named.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies.arms import each
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.io.results import to_document
from strainwave.monitoring.comparison import DIFFERS, compare
from strainwave.monitoring.estimates import Estimates, estimates_of
from strainwave.pipeline import identify
from strainwave.virtual.families import catalogue
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.families.short_records import plans, with_short_records
from strainwave.virtual.records import recorded

_SERIES = 9000  # of the catalogue
_UPRIGHT = 3  # one arm in as many
_LEVEL = 0.05
_CHANGED = {"stiffness": "gear_stiffness", "friction": "motor_coulomb_friction"}

Changes = dict[str, float]


def compared(number: int, *, changes: Changes) -> dict[str, Any]:
    """What is said of an arm's two visits."""
    rng = np.random.default_rng([2026, number])
    upright = number % _UPRIGHT == 0
    rig = with_short_records(catalogue.drawn(number, _SERIES), upright=upright, rng=rng)
    found: dict[str, Any] = {"seed": number, "spring": rig.study.arm.joints[0].spring}
    try:
        first = _visit(rig, rig.values, [number, 1])
        second = _visit(rig, _changed(rig.values, changes), [number, 2])
    except (InvalidInput, NumericalFailure) as refusal:
        return found | {"failure": str(refusal)}
    result = compare([first, second], _LEVEL)
    pair, joint = result.pairs[0], result.pairs[0].joint
    return found | {
        "status": [first.status, second.status],
        "differs": result.differs,
        "named": [p.first.label for p in pair.parameters if result.verdict(p) == DIFFERS],
        "p": [p.p for p in pair.parameters],
        "joint_p": joint.p if joint is not None else None,
    }


def _visit(rig: Rig, values: Values, seed: list[int]) -> Estimates:
    """One visit, through all stages."""
    arm = Arm.of(rig.study.arm)
    logs = {}
    motions = int(np.random.default_rng(seed).integers(2**31))
    for k, (experiment, plan) in enumerate(
        zip(rig.study.experiments, plans(rig, motions), strict=True)
    ):
        rng = np.random.default_rng([*seed, k])
        logs[experiment.name] = recorded(
            rig.study, arm, plan, values, rig.noise, rng, simulate, experiment.name
        )
    return estimates_of(to_document(identify(rig.study, data=logs, threads=1)), Path(f"{seed}"))


def _changed(values: Values, changes: Changes) -> Values:
    factors = {_CHANGED[what]: 1.0 + percent / 100.0 for what, percent in changes.items()}
    return {
        (name, joint): value
        * next((f for start, f in factors.items() if joint == 1 and name.startswith(start)), 1.0)
        for (name, joint), value in values.items()
    }


def main() -> None:
    """Count how often two visits are said to differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=60)
    parser.add_argument("--at-once", type=int)
    for what in _CHANGED:
        parser.add_argument(f"--{what}", type=float, default=0.0, help="change of joint 1 [%%]")
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    changes = {what: getattr(chosen, what) for what in _CHANGED if getattr(chosen, what)}
    found = list(each(chosen.arms, partial(compared, changes=changes), chosen.out, chosen.at_once))
    Console(width=120).print(_counted(found, changes))


def _counted(found: list[dict[str, Any]], changes: Changes) -> Table:
    table = Table(box=None, title=f"Two visits, changed by {changes or 'nothing'}")
    for head in ("both visits", "pairs", "differ", "the change named", "p below 5 %", "joint"):
        table.add_column(head)
    starts = tuple(_CHANGED[what] for what in changes)
    pairs = [one for one in found if "failure" not in one]
    determined = [one for one in pairs if set(one["status"]) == {"determined"}]
    for title, some in (("determined", determined), ("of any status", pairs)):
        p = np.array([value for one in some for value in one["p"]])
        joint = np.array([one["joint_p"] for one in some if one["joint_p"] is not None])
        named = sum(any(n.startswith(starts) for n in one["named"]) for one in some)
        table.add_row(
            title,
            str(len(some)),
            str(sum(one["differs"] for one in some)),
            str(named) if starts else "",
            f"{100.0 * np.mean(p < _LEVEL):.1f} % of {len(p)}" if len(p) else "",
            f"{100.0 * np.mean(joint < _LEVEL):.1f} % of {len(joint)}" if len(joint) else "",
        )
    return table


if __name__ == "__main__":
    main()
