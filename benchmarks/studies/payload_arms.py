"""Loads on drawn arms in MuJoCo: `python -m benchmarks.studies.payload_arms --arms 100`.

Arms of 2 to 7 joints, in turn with rigid joints and motor torques, with elastic joints and motor
signals, and with rigid joints and joint torque sensors, are identified from their own records of
10 s without a load. Then they carry a load of 0.1 to 30 % of what they can carry for 10 s, with dry
and viscous friction changed by up to 10 %. Printed are the errors and the coverage of 95 %
intervals by parameter. Elastic arms of up to three joints are identified by all stages, longer ones
by the rigid stage. The same samples one by one give the load by a stream.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

import strainwave as sw
from benchmarks.console import Console, share_of
from benchmarks.families.rigs import between
from benchmarks.studies.arms import run_all
from benchmarks.studies.drawn_chains import Chain, draw_chain
from benchmarks.studies.engine import STEP, in_mujoco
from strainwave.domain import ArmDescription, Experiment, FloatArray, PayloadEstimate, Study
from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.domain.keys import Values
from strainwave.domain.study import Channel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import STAGES
from strainwave.virtual.experiments import default_plan, record_experiment

KINDS = ("rigid, motor torque", "elastic, motor signals", "rigid, joint torque sensors")
PARAMETERS = ("mass", "x", "y", "z", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
SHARES = (1e-3, 0.3)
"""Smallest and largest load over what the arm carries."""
MAX_FULL_JOINTS = 3
"""Elastic arms of more joints are identified by the rigid stage alone, which takes seconds."""
_RIGID_STEP = 2.5e-4  # [s] of MuJoCo without the vibration of gears
_NOISE_SHARE = 5e-3  # of measured torques: standard deviation over the motor's largest torque
_FRICTION_CHANGE = 0.1  # largest relative change from the identification to the load
_USED_SHARE = 0.8  # of the motors' torque, for links, load and friction
_ACCELERATION = 4.0  # [rad/s^2] of all links, for the load that an arm carries
_LEVER = 0.1  # [m] of that load from the last frame
_N_POSTURES = 50
_VOLTAGE_LIMIT = 10.0  # [V]
_CENTRE = (0.02, 0.15)  # [m] distance of the load's centre from the last frame
_SIZE = (0.03, 0.2)  # [m] edges of a load
_DENSITY = 8000.0  # [kg/m^3] largest mean density of a load
_MASS_ERROR, _CENTRE_ERROR = 0.01, 3e-3  # relative, [m]
_STDS = 3.0


@dataclass(frozen=True, slots=True)
class Case:
    """An arm, its parameters without and with the load, and the load."""

    chain: Chain
    kind: str
    loaded: Values
    rated: float  # [kg] that the arm carries
    load: FloatArray  # (10,) mass, centre, inertia xx, xy, xz, yy, yz, zz about it


def draw_case(seed: int) -> Case:
    """Arm and load of a seed; kinds of arms change with every turn of the numbers of joints."""
    rng = np.random.default_rng([45, seed])
    chain = draw_chain(seed, sensors_in_turn=("motor",))
    kind = KINDS[(seed + seed // 6) % len(KINDS)]
    study, values = chain.study, chain.values
    rated = _carried(rng, study.arm, values)
    if kind.startswith("rigid"):
        study, values = _with_rigid_joints(study, values)
    loaded = dict(values)
    for name, joint in values:
        if "coulomb" in name or "viscous" in name:
            loaded[name, joint] *= 1.0 + float(rng.uniform(-_FRICTION_CHANGE, _FRICTION_CHANGE))
    mass = rated * between(rng, *SHARES)
    direction = rng.normal(size=3)
    centre = between(rng, *_CENTRE) * direction / np.linalg.norm(direction)
    edges = np.maximum(rng.uniform(*_SIZE, 3), (mass / _DENSITY) ** (1.0 / 3.0))
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    inertia = turned @ np.diag(np.sum(edges**2) - edges**2) @ turned.T * mass / 12.0
    last = Arm.of(study.arm).base_names[-10:]
    for key, x in zip(last, standard_parameters(mass, centre, inertia), strict=True):
        loaded[key] = loaded.get(key, 0.0) + float(x)
    load = np.concatenate([[mass], centre, inertia[np.triu_indices(3)]])
    full = kind.startswith("elastic") and study.arm.n_joints <= MAX_FULL_JOINTS
    experiments = study.experiments if full else study.experiments[:1]
    chain = replace(chain, study=replace(study, experiments=experiments), values=values)
    return Case(chain, kind, loaded, rated, load)


def _carried(rng: np.random.Generator, arm: ArmDescription, values: Values) -> float:
    """Mass [kg] at the last frame whose torque the motors have left in all postures."""
    links = Arm.of(arm)
    base = links.parameter_vector(values)[: len(links.base_names)]
    unit = np.zeros_like(base)
    unit[-10:] = standard_parameters(1.0, np.array([0.0, 0.0, _LEVER]), np.zeros((3, 3)))
    angle = rng.uniform(-1.2, 1.2, (_N_POSTURES, arm.n_joints))
    fast = rng.choice((-1.0, 1.0), angle.shape) * _ACCELERATION
    own, per_mass = (links.link_torques(b, angle, 0.0 * angle, fast) for b in (base, unit))
    ratios = np.abs(links.gear_ratios)
    dry = [values["motor_coulomb_friction", i + 1] for i in range(arm.n_joints)]
    limit = _USED_SHARE * _VOLTAGE_LIMIT * links.torque_per_volt - np.array(dry)
    left = limit / ratios - np.abs(own).max(axis=0)
    return float(np.min(np.maximum(left, 0.0) / np.abs(per_mass).max(axis=0)))


def _with_rigid_joints(study: Study, values: Values) -> tuple[Study, Values]:
    """The arm without elasticity of its gears, whose inputs are torques [N m] at the motors."""
    arm = study.arm
    per_volt = Arm.of(arm).torque_per_volt
    joints = [
        replace(joint, spring="rigid", torque_per_volt=None, current_loop_hz=None)
        for joint in arm.joints
    ]
    servo = arm.servo
    assert servo is not None
    servo = replace(
        servo,
        kp=tuple((per_volt * servo.kp).tolist()),
        ki=tuple((per_volt * servo.ki).tolist()),
        limit=_VOLTAGE_LIMIT * float(per_volt.max()),
    )
    kept = {key: x for key, x in values.items() if not key[0].startswith("gear_")}
    return replace(study, arm=replace(arm, joints=tuple(joints), servo=servo)), kept


def write_case(case: Case, folder: Path, seed: int) -> None:
    """Simulate the records of an arm without its load, study.toml, and with it, load.toml."""
    study, n = case.chain.study, case.chain.study.arm.n_joints
    load = Experiment("load", "load.parquet", "motion", study.experiments[0].control)
    for name, experiments, values in (
        ("study.toml", study.experiments, case.chain.values),
        ("load.toml", (load,), case.loaded),
    ):
        for number, experiment in enumerate(experiments):
            rng = np.random.default_rng([seed, number, len(name)])
            write_log(folder / experiment.file, _record(case, experiment, values, rng))
        channels: dict[str, Channel] = {}
        if case.kind == KINDS[2]:
            names = [f"{c}{i + 1}" for i in range(n) for c in ("tau_l", "theta_m", "ref")]
            channels = {each: Channel(each) for each in ("t", *names)}
        path = folder / name
        write_study(replace(study, experiments=experiments, path=path, channels=channels), path)


def _record(
    case: Case, experiment: Experiment, values: Values, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Log of one experiment with noise of measured torques."""
    study, arm = case.chain.study, Arm.of(case.chain.study.arm)
    carried: list[FloatArray] = []

    def simulator(
        arm: Arm, values: Values, drive: Drive, *, record: Sequence[Any], **clock: Any
    ) -> Trajectory:
        step = STEP if arm.joints[0].elastic else _RIGID_STEP
        record = [*record, "gear_torque"]
        trajectory = in_mujoco(arm, values, drive, record=record, step=step, **clock)
        carried.append(trajectory.quantities["gear_torque"])
        return trajectory

    plan = default_plan(study.path, arm, experiment, values, rng, case.chain.sample_time)
    noise = case.chain.noise
    columns = record_experiment(study, arm, plan, values, noise, rng, simulator)
    if case.kind == KINDS[1]:
        return columns
    largest = np.abs([columns[f"torque{i + 1}"] for i in range(arm.n_joints)]).max(axis=1)
    stds = _NOISE_SHARE * largest
    for i in range(arm.n_joints):
        name, torque = f"torque{i + 1}", columns[f"torque{i + 1}"]
        if case.kind == KINDS[2]:
            del columns[name]
            stds[i] /= abs(arm.gear_ratios[i])
            name, torque = f"tau_l{i + 1}", carried[0][:, i]
        columns[name] = torque + rng.normal(0.0, stds[i], len(torque))
    return columns


def evaluate(seed: int, folder: Path) -> dict[str, Any]:
    """Errors of the load of one arm; logs and the arm's result in a folder are used again."""
    case, place = draw_case(seed), folder / str(seed)
    arm = case.chain.study.arm
    share = float(case.load[0] / case.rated)
    head = {"seed": seed, "joints": arm.n_joints, "kind": case.kind, "share": share}
    try:
        if not (place / "load.toml").exists():
            place.mkdir(parents=True, exist_ok=True)
            write_case(case, place, seed)
        if not (place / "result.json").exists():
            stages = STAGES if len(case.chain.study.experiments) > 1 else ("rigid",)
            sw.identify(place / "study.toml", stages=stages).save(place / "result.json")
        result, begin = sw.read_result(place / "result.json"), time.process_time()
        estimate = result.payload(place / "load.toml")
        head["cpu"] = time.process_time() - begin
        head["parameters"] = _errors(estimate, case.load)
        return head | {"stream": _errors(_by_stream(result, place / "load.toml"), case.load)}
    except Exception as failure:  # counted, so that the other arms run
        return head | {"failure": f"{type(failure).__name__}: {failure}"}


def _by_stream(result: sw.Result, path: Path) -> PayloadEstimate:
    """The load by a stream of the samples of a record."""
    (log,) = read_logs(read_study(path))
    kind = next(kind for kind in ("tau_l", "torque", "u") if f"{kind}1" in log.channels)
    numbers = range(1, sum(name.startswith("theta_m") for name in log.channels) + 1)
    angles, torques = (
        np.column_stack([log.channels[f"{name}{i}"] for i in numbers]) for name in ("theta_m", kind)
    )
    stream = result.payload_stream(sample_time=log.sample_time)
    for angle, torque in zip(angles, torques, strict=True):
        stream.update(angle, torque)
    return stream.estimate


def _errors(estimate: PayloadEstimate, load: FloatArray) -> dict[str, dict[str, Any]]:
    """Errors of the members of the load that have a value."""
    members = (estimate.mass, *estimate.xyz, *estimate.inertia_about_centre)
    return {
        name: {
            "error": member.value - true,
            "std": member.std,
            "size": load[0],
            "inside": bool(member.ci95[0] <= true <= member.ci95[1]),
        }
        for name, member, true in zip(PARAMETERS, members, load.tolist(), strict=True)
        if member is not None
    }


def is_within(name: str, row: dict[str, Any]) -> bool:
    """Whether a mass or a coordinate is within the permitted error or three deviations."""
    permitted = _MASS_ERROR * row["size"] if name == "mass" else _CENTRE_ERROR
    return bool(abs(row["error"]) <= max(permitted, _STDS * row["std"]))


def tabulate(results: Sequence[dict[str, Any]], key: str) -> list[Table]:
    """Coverage by parameter, and errors by kind of arm; `key` is "parameters" or "stream"."""
    done = [result for result in results if "failure" not in result]
    heads = ("parameter", "values", "inside", "rms error/std", "median std")
    by_parameter = Table(*heads, box=None, title="stream" if key == "stream" else "record")
    for name in PARAMETERS:
        rows = [r[key][name] for r in done if name in r[key]]
        if rows:
            error, std, size = (
                np.array([row[k] for row in rows]) for k in ("error", "std", "size")
            )
            median = np.median(std / size) if name == "mass" else np.median(std)
            units = {
                "mass": f"{100.0 * median:.2g} %",
                **dict.fromkeys("xyz", f"{1e3 * median:.2g} mm"),
            }
            by_parameter.add_row(
                name,
                str(len(rows)),
                share_of([row["inside"] for row in rows]),
                f"{np.sqrt(np.mean((error / std) ** 2)):.2f}",
                units.get(name, f"{median:.2g} kg m^2"),
            )
    of_kinds = ("mass within", "centre within", "inside", "rms error/std", "median CPU")
    by_kind = Table("arm", "arms", *of_kinds, box=None)
    for kind in (*KINDS, ""):
        group = [r for r in done if kind in ("", r["kind"])]
        every = [(name, row) for r in group for name, row in r[key].items()]
        if not every:
            continue
        masses, centres = (
            [is_within(name, row) for name, row in every if name in names]
            for names in (("mass",), "xyz")
        )
        normalised = [row["error"] / row["std"] for _, row in every]
        by_kind.add_row(
            kind or "all",
            str(len(group)),
            share_of(masses),
            share_of(centres),
            share_of([row["inside"] for _, row in every]),
            f"{np.sqrt(np.mean(np.square(normalised))):.2f}",
            f"{np.median([r['cpu'] for r in group]):.1f} s",
        )
    return [by_parameter, by_kind]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--at-once", type=int, default=os.cpu_count())
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("build/payload-arms"),
        help="of logs and results, which a repeated run uses again",
    )
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    options = parser.parse_args()
    console, results = Console(width=140), []
    work = partial(evaluate, folder=options.folder)
    for result in run_all(range(options.arms), work, options.out, options.at_once):
        results.append(result)
        text = f"arm {result['seed']}, {result['kind']}, {result['joints']} joints: "
        wrong = [name for name, row in result.get("parameters", {}).items() if not row["inside"]]
        console.print(text + result.get("failure", f"outside {', '.join(wrong) or 'none'}"))
    for key in ("parameters", "stream"):
        for table in tabulate(results, key):
            console.print(table)


if __name__ == "__main__":
    main()
