"""The rigid step on measured arms: `python -m benchmarks.studies.serial_rigid KINOVA TX40`.

KINOVA is a folder with a study; TX40 has the published CSV files of a Staubli TX40, for which the
study is built here. Printed are held-out torque fits of every joint, by strainwave and by a plain
weighted least squares with Pinocchio's regressor, on the same motor signals, the same low-pass and
the same samples: those at which the joint slides. The plain fit is repeated with the Coulomb
regressor that belongs to low-passed torques. For the TX40 the base parameters of the whole
record follow, with the published ones and their standard deviations, and the friction of axes 1 to
4 at half of their largest speed: the published law has Coulomb and viscous friction only.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from rich.table import Table

from benchmarks.console import Console
from benchmarks.peers.rigid_chain import fit_plain
from strainwave.domain import FloatArray, FrictionTerm, RigidModel, RigidOptions, Signals
from strainwave.domain.keys import Key
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import predict_torque, torque_parts
from strainwave.identification import rigid
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.numerics.filters import low_pass
from strainwave.signals import hygiene
from strainwave.signals.motor import mark_standstill, prepare_motor_signals

_QUARTER = 0.5 * np.pi
_TX40_RATIOS = (32, 32, 45, -48, 45, 32)  # motor turns per turn of the link
# modified Denavit-Hartenberg frames: position [m] and turn about x [rad] in the frame before
_TX40_FRAMES = (
    ((0.0, 0.0, 0.0), 0.0),
    ((0.0, 0.0, 0.0), -_QUARTER),
    ((0.225, 0.0, 0.035), 0.0),
    ((0.0, -0.225, 0.0), _QUARTER),
    ((0.0, 0.0, 0.0), -_QUARTER),
    ((0.0, 0.0, 0.0), _QUARTER),
)
_TX40_ZEROS = {2: -_QUARTER, 3: _QUARTER}  # [rad] link angles at motor angle 0
_TX40_SAMPLE_TIME = 2e-4  # [s]
FIRST, SECOND, WHOLE = (0.1, 5.0), (5.0, 7.5), (0.1, 7.5)  # [s]
# parameters of the same meaning in both models, with their signs
_SYMBOLS = {
    "link_inertia_": "I",
    "link_first_moment_": "m",
    "motor_inertia": "Ia",
}
_HALF_SPEED = 0.4, 0.6  # of the largest speed


def fit_study(path: Path) -> tuple[Arm, RigidModel, tuple[Signals, ...], tuple[Signals, ...]]:
    """Rigid model of a study, with the signals of its fitted and its check records."""
    study = read_study(path)
    arm = Arm.of(study.arm)
    usable, _ = hygiene.repair_records(read_logs(study), arm)
    records = mark_standstill([prepare_motor_signals(log, arm) for log in usable])
    motion, checks = (
        tuple(r for r in records if r.experiment.use == use) for use in ("motion", "check")
    )
    return arm, rigid.fit_rigid(motion, arm, study.options.rigid), motion, checks


def held_out_fits(
    arm: Arm,
    solution: FloatArray,
    records: Sequence[Signals],
    cutoff_hz: float,
    terms: Sequence[FrictionTerm] = (),
) -> FloatArray:
    """Fit [%] of each joint's torque over all records, where the joint slides: (n_joints,)."""
    error, spread = np.zeros(arm.n_joints), np.zeros(arm.n_joints)
    for record in records:
        T = record.sample_time
        torque = predict_torque(arm, solution, record, int(0.5 / (cutoff_hz * T)), terms)
        measured, predicted = (low_pass(x, cutoff_hz, T) for x in (record.motor_torque, torque))
        for i, slides in enumerate((record.direction != 0.0).T):
            y = measured[slides, i]
            error[i] += np.sum((y - predicted[slides, i]) ** 2)
            spread[i] += np.sum((y - y.mean()) ** 2) if y.size else 0.0
    return np.asarray(100.0 * (1.0 - np.sqrt(error / spread)))


def write_tx40(folder: Path, copy: Path, records: Mapping[str, tuple[float, float]]) -> Path:
    """Write a study of the TX40 with one experiment per use and time interval [s]."""
    angles, torques = (
        pyarrow.csv.read_csv(folder / f"{name}.csv") for name in ("pos_read_data", "curr_data")
    )
    columns = {"t": _TX40_SAMPLE_TIME * np.arange(angles.num_rows)}
    text = '[arm]\nkind = "serial"\ngravity = [0.0, 0.0, -9.81]\n'
    channels = "[channels]\n"
    for i, (ratio, (xyz, turn)) in enumerate(zip(_TX40_RATIOS, _TX40_FRAMES, strict=True), start=1):
        columns[f"theta_m{i}"] = angles.column(i - 1).to_numpy()
        columns[f"torque{i}"] = torques.column(i - 1).to_numpy()
        text += f'[[joint]]\nmotion = "revolute"\nspring = "rigid"\ngear_ratio = {1.0 / ratio!r}\n'
        text += f"origin = {{ xyz = {list(xyz)}, rpy = [{turn!r}, 0.0, 0.0] }}\n"
        text += "axis = [0.0, 0.0, 1.0]\n"
        if i in _TX40_ZEROS:
            offset = ratio * _TX40_ZEROS[i]
            channels += f'theta_m{i} = {{ column = "theta_m{i}", offset = {offset!r} }}\n'
    coupling = np.eye(len(_TX40_RATIOS))
    coupling[5, 4] = -1.0  # motor 6 turns with axes 5 and 6
    text += f"[transmission]\ncoupling = {coupling.tolist()}\n{channels}"
    for use, (start, stop) in records.items():
        text += f'[[experiment]]\nname = "{use}"\nfile = "run.parquet"\nuse = "{use}"\n'
        text += f"control = {['servo'] * 6}\nstart = {start}\nstop = {stop}\n".replace("'", '"')
    pyarrow.parquet.write_table(pa.table(columns), copy / "run.parquet")
    (copy / "study.toml").write_text(text)
    return copy / "study.toml"


def published(folder: Path) -> dict[str, tuple[float, float]]:
    """Published values and standard deviations by the first symbol of each combination."""
    with (folder / "published_base_parameters.csv").open() as file:
        rows = [row for row in csv.reader(file) if len(row) > 2 and row[1][-1:].isdigit()]
    return {
        row[0].split(" ")[0]: (float(row[1]), abs(float(row[1])) * float(row[2]) / 100.0)
        for row in rows
    }


def published_symbols(arm: Arm) -> Iterator[tuple[Key, str, float]]:
    """Parameters that both models have: key, published symbol, and published value per our value.

    The published inertia of motor 6 is not in its own row: it has no counterpart.
    """
    for column in arm.rigid_columns:
        name, joint = column.name.removeprefix("grouped_"), column.joint or 0
        prefix = next((each for each in _SYMBOLS if name.startswith(each)), None)
        of_links = prefix is not None and prefix.startswith("link")
        if prefix is None or not (of_links or joint < 5) or (name, joint) == ("link_inertia_zz", 6):
            continue
        factor = 1.0 if of_links else float(_TX40_RATIOS[joint - 1] ** 2)
        yield column.key, f"{_SYMBOLS[prefix]}{name.removeprefix(prefix)}{joint}", factor


def published_by_key(folder: Path, path: Path) -> dict[Key, float]:
    """Published values by the keys of our study's parameters."""
    reference, arm = published(folder), Arm.of(read_study(path).arm)
    return {
        key: reference[symbol][0] / factor
        for key, symbol, factor in published_symbols(arm)
        if symbol in reference
    }


def frictions_at_half_speed(
    arm: Arm, model: RigidModel, record: Signals, law: Mapping[str, tuple[float, float]]
) -> list[tuple[float, float]]:
    """Mean friction [N m] of axes 1 to 4 at the link, of the model and of the published law."""
    motion = record.motor_angle, record.motor_velocity, record.motor_acceleration
    speed = np.abs(record.motor_velocity)
    viscous = arm.joint_friction(model.solution)[:, 0]
    parts = torque_parts(arm, model.solution, motion, model.friction_terms)
    friction = parts.dry_friction + viscous * speed
    low, high = (share * speed.max(axis=0) for share in _HALF_SPEED)
    rows = []
    for i in range(4):
        n, at = abs(_TX40_RATIOS[i]), (speed[:, i] > low[i]) & (speed[:, i] < high[i])
        expected = law[f"fs{i + 1}"][0] + law[f"fv{i + 1}"][0] * speed[at, i] / n
        rows.append((n * float(friction[at, i].mean()), float(expected.mean())))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinova", type=Path)
    parser.add_argument("tx40", type=Path)
    arguments = parser.parse_args()
    table = Table("arm", "low-pass", "method", *map(str, range(1, 8)), box=None)
    with TemporaryDirectory() as name:
        copy = Path(name)
        halves = write_tx40(arguments.tx40, copy, {"motion": FIRST, "check": SECOND})
        for label, path, cutoff_hz in (
            ("Kinova Gen3", arguments.kinova / "study.toml", 4.0),
            ("TX40", halves, 10.0),
        ):
            arm, model, motion, checks = fit_study(path)
            same = rigid.fit_rigid(motion, arm, RigidOptions(bandwidth_hz=cutoff_hz))
            for method, solution, terms in (
                ("strainwave, own band", model.solution, model.friction_terms),
                ("strainwave, same filter", same.solution, same.friction_terms),
                ("Pinocchio", fit_plain(arm, motion, cutoff_hz), ()),
                (
                    "Pinocchio, filtered sign",
                    fit_plain(arm, motion, cutoff_hz, filters_sign=True),
                    (),
                ),
            ):
                fits = held_out_fits(arm, solution, checks, cutoff_hz, terms)
                table.add_row(label, f"{cutoff_hz:g} Hz", method, *(f"{fit:.1f}" for fit in fits))
            Console().print(f"{label}: own band of {model.bandwidth_hz:.0f} Hz")
        Console().print(table)
        arm, model, motion, _ = fit_study(write_tx40(arguments.tx40, copy, {"motion": WHOLE}))
    values = Table("parameter", "strainwave", "std", "published", "std", "difference", box=None)
    reference = published(arguments.tx40)
    keys = [column.key for column in arm.rigid_columns]
    stds = np.sqrt(np.diag(model.covariance)).tolist()
    estimates = dict(zip(keys, zip(model.solution.tolist(), stds, strict=True), strict=True))
    for key, symbol, factor in published_symbols(arm):
        if symbol in reference:
            (value, std), (expected, of_expected) = estimates[key], reference[symbol]
            numbers = (factor * value, factor * std, expected, of_expected)
            difference = (factor * value - expected) / np.hypot(factor * std, of_expected)
            values.add_row(symbol, *(f"{x:.4g}" for x in numbers), f"{difference:.1f}")
    Console().print(values)
    friction = Table("axis", "friction [N m]", "published", "difference %", box=None)
    rows = frictions_at_half_speed(arm, model, motion[0], reference)
    for axis, (value, expected) in enumerate(rows, start=1):
        percent = 100.0 * (value / expected - 1.0)
        friction.add_row(str(axis), f"{value:.2f}", f"{expected:.2f}", f"{percent:.1f}")
    Console().print(friction)


if __name__ == "__main__":
    main()
