"""Errors of every stage on logs of known arms: `python -m benchmarks.studies.lab FOLDER...`.

A folder has a study.toml, its logs, and truth.json, a parameter file. Printed are the largest
relative errors by kind of parameter and stage, and the number of values inside their 95 %
intervals. `--without-link-sensors` removes all link channels first.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.console import Console
from strainwave.domain import Identification, Parameter
from strainwave.domain.keys import Values
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
_LINK_CHANNELS = ("a", "gyro", "theta_l", "deflection")
_COUNTED = (*(name for names in KINDS.values() for name in names), "friction_offset")


def parameters_by_stage(result: Identification) -> dict[str, list[Parameter]]:
    """Parameters by stage; of the decoupled stage, by record and by joint."""
    by_stage = {"rigid": list(result.rigid.parameters) if result.rigid else []}
    records = [r.physical for r in result.records if r.physical is not None]
    frequency = {e.name for e in result.study.experiments if e.use == "frequency"}
    by_stage["decoupled, each record"] = [
        p for model in records if set(model.experiments) <= frequency for p in model.parameters
    ]
    by_stage["decoupled, each joint"] = [p for joint in result.joints for p in joint.parameters]
    by_stage["whole arm"] = list(result.whole_arm.parameters) if result.whole_arm else []
    by_stage["final table"] = list(result.parameters)
    return by_stage


def error_cells(parameters: Iterable[Parameter], true_values: Values) -> list[str]:
    """Largest error of each kind [%], and the number of values inside their intervals."""
    largest: dict[str, float] = defaultdict(float)
    inside, counted = 0, 0
    for p in parameters:
        true = true_values.get((p.name, p.joint))
        if true is None or p.value is None or p.name not in _COUNTED:
            continue
        kind = next((kind for kind, names in KINDS.items() if p.name in names), None)
        if kind is not None and true != 0.0:
            largest[kind] = max(largest[kind], abs(p.value / true - 1.0))
        if p.ci95 is not None:
            counted += 1
            inside += p.ci95[0] <= true <= p.ci95[1]
    errors = [f"{100.0 * largest[kind]:.2g}" if kind in largest else "" for kind in KINDS]
    return [*errors, f"{inside}/{counted}" if counted else ""]


def without_link_sensors(folder: Path, copy: Path) -> None:
    """Copy logs and study to the folder `copy`, without link channels."""
    study = read_study(folder / "study.toml")
    removed = {f"{name}{i}" for name in _LINK_CHANNELS for i in range(1, study.arm.n_joints + 1)}
    experiments = []
    for experiment in study.experiments:
        log = logs.read_log(study, experiment)
        channels = {name: x for name, x in log.channels.items() if name not in removed}
        file = f"{experiment.name}.parquet"
        logs.write_log(copy / file, {"t": log.time, **channels})
        experiments.append(replace(experiment, file=file, start=None, stop=None, add={}))
    joints = tuple(
        replace(joint, accelerometer_distance=None, accelerometer_hz=None, gyro_hz=None)
        for joint in study.arm.joints
    )
    reduced = replace(
        study, arm=replace(study.arm, joints=joints), experiments=tuple(experiments), channels={}
    )
    write_study(reduced, copy / "study.toml")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument(
        "--without-link-sensors", action="store_true", help="remove the link channels first"
    )
    options = parser.parse_args()
    console = Console(width=160)
    for folder in options.folders:
        result = _identify(folder, without_links=options.without_link_sensors)
        true_values = derived(
            read_parameters(folder / "truth.json"), read_study(folder / "study.toml").arm
        )
        title = f"{folder.name}{', no link sensors' if options.without_link_sensors else ''}"
        table = Table("stage", *(f"{kind} %" for kind in KINDS), "inside", box=None, title=title)
        for stage, parameters in parameters_by_stage(result).items():
            table.add_row(stage, *error_cells(parameters, true_values))
        console.print(f"{folder.name}: {result.verdict.status}")
        console.print(table)


def _identify(folder: Path, *, without_links: bool) -> Identification:
    if not without_links:
        return identify(folder / "study.toml")
    with TemporaryDirectory() as copy:
        without_link_sensors(folder, Path(copy))
        return identify(Path(copy) / "study.toml")


if __name__ == "__main__":
    main()
