"""Errors of every stage on logs of known arms: `python -m benchmarks.studies.lab FOLDER...`.

A folder holds a study.toml, its logs and truth.json, as `strainwave simulate` takes parameters.
Printed are the largest relative errors by kind of parameter, stage by stage, and how many values
lie inside their 95 % intervals: the tables of the README. With `--without-link-sensors` the logs
are copied first, without any channel of a link.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

from strainwave.domain import Identification, Parameter
from strainwave.domain.parameters import Values
from strainwave.io import logs
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived

KINDS = {
    "inertias": ("alpha", "beta", "gamma", "rigid_inertia", "motor_inertia", "link_inertia"),
    "gravity": ("gravity_torque_1", "gravity_torque_2"),
    "stiffness": ("gear_stiffness", "gear_stiffness_k1", "gear_stiffness_k2", "gear_stiffness_k3"),
    "knees": ("gear_knee_t1", "gear_knee_t2"),
    "gear damping": ("gear_damping",),
    "Coulomb": ("motor_coulomb_friction",),
    "total viscous": ("total_viscous_friction",),
}
_OF_LINKS = ("a", "gyro", "theta_l", "deflection")
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


def without_link_sensors(folder: Path, copy: Path) -> None:
    """Copy logs and study to another folder, with motor angles and voltages only.

    Parameters
    ----------
    folder, copy : Path
    """
    study = read_study(folder / "study.toml")
    gone = {f"{name}{i}" for name in _OF_LINKS for i in range(1, study.arm.n_joints + 1)}
    experiments = []
    for experiment in study.experiments:
        log = logs.read_log(study, experiment)
        kept = {name: x for name, x in log.channels.items() if name not in gone}
        file = f"{experiment.name}.parquet"
        logs.write_log(copy / file, {"t": log.time, **kept})
        experiments.append(replace(experiment, file=file, start=None, stop=None, add={}))
    joints = tuple(
        replace(joint, accelerometer_distance=None, accelerometer_hz=None, gyro_hz=None)
        for joint in study.arm.joints
    )
    own = replace(
        study, arm=replace(study.arm, joints=joints), experiments=tuple(experiments), channels={}
    )
    write_study(own, copy / "study.toml")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument(
        "--without-link-sensors", action="store_true", help="drop the links' channels first"
    )
    chosen = parser.parse_args()
    console = Console(width=160)
    for folder in chosen.folders:
        found = _identified(folder, bare=chosen.without_link_sensors)
        truth = derived(
            read_parameters(folder / "truth.json"), read_study(folder / "study.toml").arm
        )
        table = Table("stage", *(f"{kind} %" for kind in KINDS), "inside", box=None)
        for stage, parameters in stages(found).items():
            table.add_row(stage, *cells(parameters, truth))
        console.print(f"{folder.name}: {found.verdict.status}")
        console.print(table)


def _identified(folder: Path, *, bare: bool) -> Identification:
    if not bare:
        return identify(folder / "study.toml")
    with TemporaryDirectory() as copy:
        without_link_sensors(folder, Path(copy))
        return identify(Path(copy) / "study.toml")


if __name__ == "__main__":
    main()
