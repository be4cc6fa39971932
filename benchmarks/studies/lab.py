"""Errors of every stage on logs of known arms: `python -m benchmarks.studies.lab FOLDER...`.

A folder holds a study.toml, its logs and truth.json, as `strainwave simulate` takes parameters.
Printed are the largest relative errors by kind of parameter, stage by stage, and how many values
lie inside their 95 % intervals: the tables of the README.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from strainwave.parameters import Values, read_parameters
from strainwave.pipeline import identify
from strainwave.records import Identification, Parameter
from strainwave.study import read_study
from strainwave.virtual import derived

KINDS = {
    "inertias": ("alpha", "beta", "gamma", "rigid_inertia", "motor_inertia", "link_inertia"),
    "gravity": ("gravity_torque_1", "gravity_torque_2"),
    "stiffness": ("gear_stiffness", "gear_stiffness_k1", "gear_stiffness_k2", "gear_stiffness_k3"),
    "knees": ("gear_knee_t1", "gear_knee_t2"),
    "gear damping": ("gear_damping",),
    "Coulomb": ("motor_coulomb_friction",),
    "total viscous": ("total_viscous_friction",),
}
_OWN = (*(name for names in KINDS.values() for name in names), "friction_offset")


def stages(found: Identification) -> dict[str, list[Parameter]]:
    """Parameters by stage; of the decoupled stage each record's on its own, too."""
    by_stage = {"rigid": list(found.rigid.parameters) if found.rigid else []}
    records = [r.physical for r in found.records if r.physical is not None]
    full = {e.name for e in found.study.experiments if e.use == "frequency"}
    by_stage["decoupled, each record"] = [
        p for model in records if set(model.experiments) <= full for p in model.parameters
    ]
    by_stage["decoupled, each joint"] = [p for joint in found.joints for p in joint.parameters]
    by_stage["whole arm"] = list(found.tuned.parameters) if found.tuned else []
    by_stage["final table"] = list(found.parameters)
    return by_stage


def cells(parameters: Iterable[Parameter], truth: Values) -> list[str]:
    """Largest error of each kind [%], and how many values lie inside their intervals."""
    worst: dict[str, float] = defaultdict(float)
    inside, counted = 0, 0
    for p in parameters:
        true = truth.get((p.name, p.joint))
        if true is None or p.value is None or p.name not in _OWN:
            continue
        kind = next((kind for kind, names in KINDS.items() if p.name in names), None)
        if kind is not None and true != 0.0:
            worst[kind] = max(worst[kind], abs(p.value / true - 1.0))
        if p.ci95 is not None:
            counted += 1
            inside += p.ci95[0] <= true <= p.ci95[1]
    found = [f"{100.0 * worst[kind]:.2g}" if kind in worst else "" for kind in KINDS]
    return [*found, f"{inside}/{counted}" if counted else ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    console = Console(width=160)
    for folder in parser.parse_args().folders:
        found = identify(folder / "study.toml")
        truth = derived(read_parameters(folder / "truth.json"), read_study(folder / "study.toml"))
        table = Table("stage", *(f"{kind} %" for kind in KINDS), "inside", box=None)
        for stage, parameters in stages(found).items():
            table.add_row(stage, *cells(parameters, truth))
        console.print(f"{folder.name}: {found.verdict.status}")
        console.print(table)


if __name__ == "__main__":
    main()
