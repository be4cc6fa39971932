"""Coverage on drawn serial chains: `python -m benchmarks.studies.drawn_chains --chains 50`.

Chains of 2 to 7 joints with random axes, links, gears of the catalogue, friction, and ratios of
either sign are simulated with short records, half of them in MuJoCo, half with the motors' signals
alone. `identify` runs on each. Printed are, per class of parameter, the share of 95 % intervals
that contain the true value and the errors; per chain the verdict, values that are silently wrong,
and processor time. Errors of base parameters are relative to the largest of their unit. A value is
silently wrong if it counts as identified, and is wrong by more than `_MAX_STDS` standard deviations
and `_MAX_ERROR`.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.families.catalogue import GEAR_CATALOGUE, GEAR_RATIOS
from benchmarks.families.rigs import between
from benchmarks.studies.arms import run_all
from benchmarks.studies.engine import in_mujoco
from strainwave.domain import (
    ArmDescription,
    Control,
    Experiment,
    FloatArray,
    Identification,
    Joint,
    Prbs,
    Servo,
    Study,
)
from strainwave.domain.arm.description import Imu, Origin, Vector, unit_in
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.study import Channel
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise, simulate
from strainwave.io.study import read_study
from strainwave.numerics.parallel import configure_worker
from strainwave.pipeline import STAGES, identify
from strainwave.virtual.experiments import Simulator, derived, simulate_study

_MAX_STDS, _MAX_ERROR = 3.0, 0.05
_COUNTS = (4096, 8192, 65536)  # of encoders, per motor turn
_SAMPLE_TIME = 5e-4  # [s] of records that excite the gears
_VOLTAGE_LIMIT = 10.0  # [V]
_PRBS = Prbs(10, 1e-3, 2, 5.0)  # on top of the servo
_SERVO_BANDWIDTHS, _KI_RATIO = (20.0, 100.0), 8.0  # [rad/s], [1/s]
_STUCK_SPEED = 0.3  # [rad/s] of a link, that the servo's proportional part must overcome
_MOTOR_ACCELERATION = 1e5  # [rad/s^2] of a motor alone at full voltage, at most
_GRAVITY = 9.81  # [m/s^2]
_TILTED_SHARE = 0.2  # of the chains stand in any attitude
_LEVER = 0.2  # [m] of an IMU
_PEAK_SHARE = 4.0  # of a rigid link's acceleration, at resonance
_N_POSTURES = 50  # at which loads of gears are evaluated
_ACCELERATION = 4.0  # [rad/s^2] of all links, for the size of the gears
_ENGINES: dict[str, Simulator] = {"own": simulate, "mujoco": in_mujoco}
_SENSORS = ("imu", "motor")
# channels of each set of sensors on the links; IMUs are in the study
_LINK_CHANNELS = {"imu": "", "motor": "", "encoder": "theta_l", "torque": "tau_l"}
_LINK_COUNTS = 2**20  # of a link encoder, per turn
_JOINT_NUMBERS = (2, 3, 4, 5, 6, 7)
_CLASSES: dict[str, Callable[[str], bool]] = {
    "stiffness": lambda name: name.startswith("gear_stiffness"),
    "gear damping": lambda name: name == "gear_damping",
    "motor inertia": lambda name: name == "motor_inertia",
    "Coulomb friction": lambda name: name == "motor_coulomb_friction",
    "friction offset": lambda name: name == "friction_offset",
    "viscous friction": lambda name: name.endswith("viscous_friction"),
    "base, inertia": lambda name: "link_inertia_" in name,
    "base, first moment": lambda name: "first_moment" in name,
    "link inertia": lambda name: name == "link_inertia",
}


@dataclass(frozen=True, slots=True)
class Chain:
    """A drawn chain and how it is simulated."""

    study: Study
    values: Values
    engine: str
    sensors: str
    noise: SensorNoise
    sample_time: float = _SAMPLE_TIME


def draw_chain(
    seed: int, numbers: Sequence[int] = _JOINT_NUMBERS, sensors_in_turn: Sequence[str] = _SENSORS
) -> Chain:
    """Chain of a seed; the seeds cycle through all `numbers` of joints, engines and sensors."""
    rng = np.random.default_rng([7, 2, seed])
    turn = seed // len(numbers)
    n = numbers[seed % len(numbers)]
    sensors = sensors_in_turn[(seed + turn // 2) % len(sensors_in_turn)]
    # MuJoCo has no torque sensors here
    engine = "own" if sensors == "torque" else list(_ENGINES)[turn % 2]
    origins = _draw_origins(rng, n)
    links = _draw_links(rng, origins)
    gravity = np.array([0.0, 0.0, -_GRAVITY])
    if rng.uniform() < _TILTED_SHARE:
        gravity = rng.normal(size=3)
        gravity *= _GRAVITY / np.linalg.norm(gravity)
    plain = [Joint("linear", 0.01, origin=origin) for origin in origins]
    arm = ArmDescription("serial", tuple(plain), gravity=_vector(gravity))
    inertias, loads = _loads(rng, Arm.of(arm), np.concatenate(links))
    drives = [_draw_drive(rng, inertias[i], loads[i]) for i in range(n)]
    values: Values = {}
    for i, (link, drive) in enumerate(zip(links, drives, strict=True), start=1):
        names = (name for name, joint in Arm.of(arm).base_names if joint == i)
        values |= {(name, i): float(x) for name, x in zip(names, link, strict=True)}
        values |= {(name, i): float(x) for name, x in drive.values.items()}
    joints = [
        replace(
            drive.joint,
            origin=origin,
            imu=_draw_imu(rng) if sensors == "imu" else None,
            link_encoder_counts=_LINK_COUNTS if sensors == "encoder" else None,
        )
        for drive, origin in zip(drives, origins, strict=True)
    ]
    gains = tuple(drive.gain for drive in drives)
    servo = Servo(
        "pi-velocity",
        period=_PRBS.clock,
        kp=gains,
        ki=tuple(_KI_RATIO * gain for gain in gains),
        limit=_VOLTAGE_LIMIT,
    )
    arm = replace(arm, joints=tuple(joints), servo=servo)
    study = Study(
        arm=arm,
        experiments=_experiments(n),
        path=Path("study.toml"),
        channels=channels_with(_LINK_CHANNELS[sensors], n),
    )
    peak = max(
        _PEAK_SHARE
        * drive.joint.torque_per_command
        * _PRBS.amplitude
        / abs(drive.joint.gear_ratio)
        / inertia
        * _LEVER
        for drive, inertia in zip(drives, inertias, strict=True)
    )
    noise = SensorNoise(accelerometer_range=max(5.0 * _GRAVITY, peak))
    return Chain(study, values, engine, sensors, noise)


def channels_with(link_kind: str, n: int) -> dict[str, Channel]:
    """Channels of the motors and of one kind of sensor on each link; none if `link_kind` is ""."""
    if not link_kind:
        return {}
    names = [f"{kind}{i}" for i in range(1, n + 1) for kind in ("u", "theta_m", "ref", link_kind)]
    return {name: Channel(name) for name in ("t", *names)}


def _draw_origins(rng: np.random.Generator, n: int) -> list[Origin]:
    """Axes parallel or orthogonal to those before, one in five in between; shorter wrists."""
    origins = []
    for i in range(n):
        length = between(rng, 0.15, 0.45) * 0.75**i
        direction = rng.normal(size=3)
        xyz = length * direction / np.linalg.norm(direction)
        quarter = 0.5 * np.pi * float(rng.choice((-1.0, 0.0, 1.0)))
        rpy = np.zeros(3)
        rpy[int(rng.integers(0, 2))] = quarter
        if rng.uniform() < 0.2:
            rpy += rng.uniform(-0.6, 0.6, 3)
        origins.append(Origin(_vector(xyz.round(4)), _vector(rpy.round(6))))
    return origins


def _vector(values: FloatArray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _draw_links(rng: np.random.Generator, origins: Sequence[Origin]) -> list[list[float]]:
    """Turned boxes between the joints, as mass, first moments and inertia about the joint."""
    links = []
    for i in range(len(origins)):
        mass = between(rng, 2.0, 6.0) * 0.7**i
        size = between(rng, 0.15, 0.35) * 0.75**i
        end = np.array(origins[i + 1].xyz) if i + 1 < len(origins) else size * rng.normal(size=3)
        centre = rng.uniform(0.2, 0.6) * end + 0.1 * size * rng.normal(size=3)
        a, b, c = (size * rng.uniform(0.3, 1.0, 3)) ** 2
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        central = turned @ np.diag([b + c, a + c, a + b]) @ turned.T * mass / 12.0
        about = central + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        pairs = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
        links.append([mass, *(mass * centre), *(float(about[pair]) for pair in pairs)])
    return links


def _loads(rng: np.random.Generator, arm: Arm, base: FloatArray) -> tuple[list[float], list[float]]:
    """Median inertia and largest torque at each joint over random postures."""
    angle = rng.uniform(-1.2, 1.2, (_N_POSTURES, arm.n_joints))
    inertias = [np.diagonal(arm.inertia_matrix(base, posture)) for posture in angle]
    rest, fast = np.zeros_like(angle), rng.choice((-1.0, 1.0), angle.shape) * _ACCELERATION
    torque = np.abs(arm.link_torques(base, angle, rest, fast))
    return np.median(inertias, axis=0).tolist(), torque.max(axis=0).tolist()


@dataclass(frozen=True, slots=True)
class _Drive:
    joint: Joint
    values: dict[str, float]
    gain: float  # [V s/rad] of the servo


def _draw_drive(rng: np.random.Generator, inertia: float, load: float) -> _Drive:
    """Smallest gear of the catalogue that carries the load, with a motor and friction."""
    fitting = [size for size, (knees, _, _) in GEAR_CATALOGUE.items() if knees[1] > 0.7 * load]
    size = fitting[0] if fitting else max(GEAR_CATALOGUE)
    knees, high, low = GEAR_CATALOGUE[size]
    ratio = int(rng.choice(GEAR_RATIOS))
    stiffness = 1e4 * (low if ratio <= 50 else high)[1] * float(rng.uniform(0.8, 1.2))
    n = float(rng.choice((-1.0, 1.0))) / ratio
    torque = abs(n) * max(float(rng.uniform(2.0, 4.5)) * knees[1], 3.0 * load)  # at full voltage
    motor = max(n**2 * inertia * between(rng, 0.3, 4.0), torque / _MOTOR_ACCELERATION)
    dry = float(rng.uniform(0.04, 0.12)) * torque
    viscous = dry * abs(n) * float(rng.uniform(0.15, 0.5))
    values = {
        "motor_inertia": motor,
        "motor_viscous_friction": viscous,
        "motor_coulomb_friction": dry,
        "friction_offset": float(rng.uniform(-0.05, 0.05)) * dry,
        "link_viscous_friction": viscous / n**2 * float(rng.uniform(0.1, 0.4)),
        "gear_stiffness": stiffness,
        "gear_damping": 2.0 * between(rng, 0.015, 0.05) * float(np.sqrt(stiffness * inertia)),
    }
    per_volt = torque / _VOLTAGE_LIMIT
    joint = Joint(
        "linear",
        n,
        torque_per_volt=float(f"{per_volt:.4g}"),
        current_loop_hz=float(f"{between(rng, 500.0, 1000.0):.3g}"),
        encoder_counts=int(rng.choice(_COUNTS)),
    )
    total = motor + n**2 * inertia
    bandwidth = float(np.clip(dry * abs(n) / _STUCK_SPEED / total, *_SERVO_BANDWIDTHS))
    return _Drive(joint, values, bandwidth * total / per_volt)


def _draw_imu(rng: np.random.Generator) -> Imu:
    xyz, rpy = rng.uniform(-0.1, 0.1, 3), rng.uniform(-np.pi / 2, np.pi / 2, 3)
    return Imu(_vector(xyz.round(3)), _vector(rpy.round(3)), 300.0, 100.0)


def _experiments(n: int) -> tuple[Experiment, ...]:
    """A motion and, for each joint, PRBS on top of its servo and a step."""
    servo: Control = "servo"
    control = (servo,) * n
    experiments = [Experiment("motion", "motion.parquet", "motion", control)]
    for i in range(1, n + 1):
        prbs, step = f"prbs-j{i}", f"step-j{i}"
        experiments.append(Experiment(prbs, f"{prbs}.parquet", "frequency", control, i, prbs=_PRBS))
        experiments.append(Experiment(step, f"{step}.parquet", "tuning", control, i))
    return tuple(experiments)


def evaluate(
    seed: int, stages: tuple[str, ...], numbers: Sequence[int], sensors: Sequence[str] = _SENSORS
) -> dict[str, Any]:
    """Draw, simulate and identify one chain; a failure is returned as a result."""
    configure_worker()  # as the command, which keeps freed memory
    return identify_chain(draw_chain(seed, numbers, sensors), seed, stages)


def identify_chain(chain: Chain, seed: int, stages: tuple[str, ...]) -> dict[str, Any]:
    """Simulate and identify a chain; a failure is returned as a result."""
    arm = Arm.of(chain.study.arm)
    head = {"seed": seed, "joints": arm.n_joints, "engine": chain.engine, "sensors": chain.sensors}
    with TemporaryDirectory() as folder:
        try:
            simulate_chain(chain, Path(folder), seed)
            path = Path(folder) / "study.toml"
            begin, cpu = time.perf_counter(), time.process_time()
            result = identify(path, stages=stages)
            head |= {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - begin}
            return head | _errors(result, derived(chain.values, read_study(path).arm))
        except Exception as failure:  # counted, so that the other chains run
            return head | {"failure": f"{type(failure).__name__}: {failure}"}


def simulate_chain(chain: Chain, folder: Path, seed: int) -> None:
    """Write the logs and the study of a chain to a folder."""
    simulate_study(
        chain.study,
        chain.values,
        folder,
        seed=seed,
        noise=chain.noise,
        as_recorded=False,
        sample_time=chain.sample_time,
        simulator=_ENGINES[chain.engine],
    )


def _errors(result: Identification, true_values: Values) -> dict[str, Any]:
    """Verdict, times, and errors of all estimates with an interval."""
    arm, verdict = result.study.arm, result.verdict
    largest: dict[str, float] = {}
    keys = [p.key for p in result.parameters if p.key in true_values]
    for key in filter(_is_of_links, keys):
        unit = unit_in(arm, key)
        largest[unit] = max(largest.get(unit, 0.0), abs(true_values[key]))
    rows = []
    for p in result.parameters:
        true = true_values.get(p.key)
        if true is None or p.value is None or p.std is None or p.ci95 is None:
            continue
        size = largest[unit_in(arm, p.key)] if _is_of_links(p.key) else abs(true) or 1.0
        rows.append(
            {
                "name": p.key[0],
                "joint": p.key[1],
                "error": (p.value - true) / size,
                "std": p.std / size,
                "inside": bool(p.ci95[0] <= true <= p.ci95[1]),
                "identified": p.key in verdict.identified,
                "stage": p.stage,
            }
        )
    return {
        "status": verdict.status,
        "reasons": [reason[:200] for reason in verdict.reasons],
        "not_identified": [label_of(*key) for key in verdict.not_identified],
        "warnings": sorted({f"{w.code}: {w.where}" for w in result.warnings}),
        "timing": {part: round(seconds, 2) for part, seconds in result.timing_s.items()},
        "parameters": rows,
    }


def _is_of_links(key: Key) -> bool:
    """Whether a key is a base parameter of the links."""
    return "link_inertia_" in key[0] or "first_moment" in key[0]


def silently_wrong(row: dict[str, Any]) -> list[str]:
    """Identified values of a run that are wrong; none if the input counts as inconsistent."""
    if row.get("status") == "inconsistent-input":
        return []
    return [
        f"{p['name']}_{p['joint']} {100.0 * p['error']:+.0f} % {p['error'] / p['std']:+.1f} std"
        for p in row.get("parameters", [])
        if p["identified"] and abs(p["error"]) > max(_MAX_STDS * p["std"], _MAX_ERROR)
    ]


def tabulate(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Tables of classes of parameters, of chains, and of times by number of joints."""
    classes = Table("class", "sensors", "values", "inside", "rms error", "largest error", box=None)
    for sensors in _LINK_CHANNELS:
        parameters = [
            p
            for row in rows
            if row["sensors"] == sensors and row.get("status") != "inconsistent-input"
            for p in row.get("parameters", [])
            if p["identified"]
        ]
        for name, belongs in _CLASSES.items():
            of_class = [p for p in parameters if belongs(p["name"])]
            if of_class:
                errors = 100.0 * np.abs([p["error"] for p in of_class])
                inside = 100.0 * float(np.mean([p["inside"] for p in of_class]))
                sizes = float(np.sqrt(np.mean(errors**2))), float(errors.max())
                cells = (f"{inside:.0f} %", *(f"{x:.2g} %" for x in sizes))
                classes.add_row(name, sensors, str(len(of_class)), *cells)
    chains = Table(
        "seed", "joints", "engine", "sensors", "status", "inside", "CPU", "wrong", box=None
    )
    for row in sorted(rows, key=lambda row: int(row["seed"])):
        hits = [p["inside"] for p in row.get("parameters", []) if p["identified"]]
        chains.add_row(
            str(row["seed"]),
            str(row["joints"]),
            row["engine"],
            row["sensors"],
            row.get("status") or row["failure"][:60],
            f"{sum(hits)}/{len(hits)}",
            f"{row.get('cpu', 0.0):.0f} s",
            "; ".join(silently_wrong(row)),
        )
    times = Table("joints", "chains", "median CPU", "largest CPU", box=None)
    for n in sorted({row["joints"] for row in rows}):
        cpu = [row["cpu"] for row in rows if row["joints"] == n and "cpu" in row]
        if cpu:
            times.add_row(str(n), str(len(cpu)), f"{np.median(cpu):.0f} s", f"{max(cpu):.0f} s")
    return [chains, classes, times, *_summaries(rows)]


_GROUPS: dict[str, Sequence[int]] = {
    "2 to 4": (2, 3, 4),
    "5 to 7": (5, 6, 7),
    "all": _JOINT_NUMBERS,
}
"""Numbers of joints whose chains are counted together."""
_ERRORS = {
    "inertias": ("motor inertia", "base, inertia"),
    "stiffness": ("stiffness",),
    "gear damping": ("gear damping",),
    "Coulomb friction": ("Coulomb friction",),
}
"""Classes whose largest error is counted together."""


def _summaries(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Verdicts, coverage and times by joints and sensors; largest errors by groups of chains."""
    verdicts = ("determined", "partly-determined", "not-determined")
    heads = ("joints", "sensors", "chains", *verdicts, "inside", "median CPU", "largest CPU")
    by_sensors = Table(*heads, box=None, title="verdicts")
    for n, sensors in sorted({(row["joints"], row["sensors"]) for row in rows}):
        group = [row for row in rows if (row["joints"], row["sensors"]) == (n, sensors)]
        inside = [p["inside"] for p in _identified(group)]
        cpu = [row["cpu"] for row in group if "cpu" in row]
        counts = [str(sum(row.get("status") == verdict for row in group)) for verdict in verdicts]
        times = (f"{x:.0f} s" for x in (np.median(cpu), max(cpu))) if cpu else ("", "")
        hits = f"{sum(inside)} of {len(inside)}"
        by_sensors.add_row(str(n), sensors, str(len(group)), *counts, hits, *times)
    errors = Table("joints", "chains", *_ERRORS, "inside", box=None, title="largest errors")
    for name, numbers in _GROUPS.items():
        group = [row for row in rows if row["joints"] in numbers]
        parameters, cells = _identified(group), []
        for classes in _ERRORS.values():
            of_class = [p for p in parameters if any(_CLASSES[c](p["name"]) for c in classes)]
            largest = max((abs(p["error"]) for p in of_class), default=np.nan)
            cells.append(f"{100.0 * largest:.2g} %")
        inside = [p["inside"] for p in parameters]
        errors.add_row(name, str(len(group)), *cells, share_of(inside))
    return [by_sensors, errors]


def _identified(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [p for row in rows for p in row.get("parameters", []) if p["identified"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chains", type=int, default=50)
    parser.add_argument("--joints", default="2,3,4,5,6,7", help="lengths of the chains, in turn")
    parser.add_argument("--sensors", default=",".join(_SENSORS), help="imu, motor, encoder, torque")
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--at-once", type=int, default=os.cpu_count())
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("build/drawn-chains.jsonl"),
        help="a repeated run continues",
    )
    options = parser.parse_args()
    numbers = [int(n) for n in options.joints.split(",")]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    stages, sensors = tuple(options.stages.split(",")), options.sensors.split(",")
    work = partial(evaluate, stages=stages, numbers=numbers, sensors=sensors)
    rows, console = [], Console(width=160)
    for row in run_all(range(options.chains), work, options.out, options.at_once):
        rows.append(row)
        outcome = row.get("status") or row["failure"]
        console.print(f"{row['seed']}: {row['joints']} joints, {row['engine']}: {outcome}")
    for table in tabulate(rows):
        console.print(table)


if __name__ == "__main__":
    main()
