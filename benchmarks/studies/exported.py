"""Held-out torques of exported arms: `python -m benchmarks.studies.exported RESULT...`.

Each RESULT is a directory that `strainwave identify` has written, with its study and logs in place.
Printed are the fits [%] of every motor's torque in the check records, over the samples at which the
motor slides and within the bandwidth of the rigid model: by the identified model, and by the
inverse dynamics of the exported arm in MuJoCo (MJCF) and Pinocchio
(URDF, whose links include the rotors, and SRDF, which has them apart).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.table import Table

import strainwave as sw
from benchmarks.console import Console
from strainwave.domain import FloatArray, Signals
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.numerics.filters import low_pass
from strainwave.signals import hygiene
from strainwave.signals.motor import mark_standstill, prepare_motor_signals

Torques = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Torques of the joints for their angles, velocities and accelerations."""


def by_mujoco(path: Path, arm: Arm) -> Torques:
    """Inverse dynamics of an MJCF; motors of elastic joints turn with their links."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data, names = mujoco.MjData(model), [model.joint(i).name for i in range(model.njnt)]
    elastic = [i for i in range(arm.n_joints) if f"motor_joint{i + 1}" in names]
    order = [names.index(name) for name in arm.joint_names]
    order += [names.index(f"motor_joint{i + 1}") for i in elastic]
    motors = np.linalg.inv(arm.transmission)[elastic]
    turns = np.vstack([np.eye(arm.n_joints), motors])  # of the joints of the file

    def torques(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        rows = []
        for motion in zip(q, dq, ddq, strict=True):
            for target, x in zip((data.qpos, data.qvel, data.qacc), motion, strict=True):
                target[order] = turns @ x
            mujoco.mj_inverse(model, data)
            rows.append(data.qfrc_inverse[order] @ turns)
        return np.array(rows)

    return torques


def by_pinocchio(path: Path, arm: Arm) -> Torques:
    """Recursive Newton-Euler algorithm of a URDF, with its damping and friction."""
    import pinocchio

    model = pinocchio.buildModelFromUrdf(str(path))
    if path.suffix == ".srdf":
        pinocchio.loadRotorParameters(model, str(path))
    model.gravity.linear = np.array(arm.gravity or (0.0, 0.0, 0.0))
    data, joints = model.createData(), [model.joints[model.getJointId(n)] for n in arm.joint_names]
    places = [joint.idx_v for joint in joints]

    def torques(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        rows = []
        for angle, velocity, acceleration in zip(q, dq, ddq, strict=True):
            v, a, configuration = np.zeros(model.nv), np.zeros(model.nv), pinocchio.neutral(model)
            v[places], a[places] = velocity, acceleration
            for joint, x in zip(joints, angle.tolist(), strict=True):
                part = [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
                configuration[joint.idx_q : joint.idx_q + joint.nq] = part
            torque = pinocchio.rnea(model, data, configuration, v, a)
            torque += model.damping * v + model.upperDryFrictionLimit * np.sign(v)
            rows.append(torque[places])
        return np.array(rows)

    return torques


def check_records(result: sw.Result) -> tuple[Arm, list[Signals]]:
    """The arm of a result, and the motor signals of the check records of its study."""
    study = read_study(Path(result.document["study"]["path"]))
    arm = Arm.of(study.arm)
    usable, _ = hygiene.repair_records(read_logs(study), arm)
    records = mark_standstill([prepare_motor_signals(log, arm) for log in usable])
    return arm, [record for record in records if record.experiment.use == "check"]


def held_out_fits(arm: Arm, record: Signals, torques: Torques, band_hz: float) -> FloatArray:
    """Fit [%] of each motor's torque where it slides; NaN for a motor that hardly does."""
    T = record.sample_time
    motion = record.motor_angle, record.motor_velocity, record.motor_acceleration
    predicted = arm.motors_of(torques(*(arm.links_of(x) for x in motion)))
    measured, predicted = (low_pass(x, band_hz, T) for x in (record.motor_torque, predicted))
    edge, fits = int(1.0 / (band_hz * T)), []
    for i, slides in enumerate((record.direction != 0.0).T):
        at = np.flatnonzero(slides[edge:-edge]) + edge
        y = measured[at, i]
        error = np.linalg.norm(y - predicted[at, i])
        enough = len(at) > 0.1 * len(slides)
        fits.append(100.0 * (1.0 - error / np.linalg.norm(y - y.mean())) if enough else np.nan)
    return np.array(fits)


def compare(result: sw.Result, folder: Path) -> Iterator[tuple[str, str, FloatArray]]:
    """Record, model and fits of the identified and the exported models."""
    arm, records = check_records(result)
    for name in ("arm.xml", "arm.urdf", "arm.srdf"):
        result.export(folder / name)
    models: dict[str, Torques] = {
        "identified": result.inverse_dynamics,
        "MJCF, MuJoCo": by_mujoco(folder / "arm.xml", arm),
        "URDF, Pinocchio": by_pinocchio(folder / "arm.urdf", arm),
        "SRDF, Pinocchio": by_pinocchio(folder / "arm.srdf", arm),
    }
    band_hz = result.document["stages"]["rigid"]["bandwidth_hz"]
    for record in records:
        for name, torques in models.items():
            yield record.experiment.name, name, held_out_fits(arm, record, torques, band_hz)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    table = Table("result", "record", "model", *(f"motor {i}" for i in range(1, 8)), box=None)
    for path in parser.parse_args().results:
        result = sw.read_result(path)
        if "rigid" not in result.document["stages"]:
            table.add_row(path.name, "", "no rigid model")
            continue
        with TemporaryDirectory() as folder:
            for record, model, fits in compare(result, Path(folder)):
                cells = ("" if np.isnan(fit) else f"{fit:.1f}" for fit in fits)
                table.add_row(path.name, record, model, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
