"""The rigid step on ten seconds of motion, compared with Pinocchio's regressor.

The built-in arm has elastic gears, Coulomb friction with stiction, and encoders. The error is the
largest relative error of base parameters, inertia of motor 2 and Coulomb friction.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.peers.rigid import pinocchio
from benchmarks.timing import Row, best_of
from strainwave.domain import Log, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification import rigid
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.signals import motor as signals
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived, simulate_study

COMPARED = ("rigid_inertia", "beta", "gamma", "motor_inertia", "motor_coulomb_friction")


def rows() -> list[Row]:
    study, log, true_values = _record()
    task, peer = "rigid step, 10 s of motion", "Pinocchio regressor, least squares"
    time = best_of(lambda: _fit_rigid(study, log), repeats=3)
    error = _error(_fit_rigid(study, log), true_values)
    try:
        peer_error = _error(pinocchio(study, log), true_values)
    except ImportError:
        return [Row(task, time, peer, None, error=error)]
    peer_time = best_of(lambda: pinocchio(study, log), repeats=3)
    return [Row(task, time, peer, peer_time, error, peer_error)]


def _record() -> tuple[Study, Log, Values]:
    values = scara.STIFF.parameters()
    with TemporaryDirectory() as folder:
        study = scara.STIFF.study(Path(folder))
        motion = tuple(e for e in study.experiments if e.name == "motion")
        motion_study = replace(study, experiments=motion)
        simulate_study(motion_study, values, Path(folder), noise=SensorNoise(), as_recorded=False)
        written = read_study(Path(folder) / "study.toml")
        return written, read_log(written, written.experiments[0]), derived(values, written.arm)


def _fit_rigid(study: Study, log: Log) -> Values:
    model = rigid.fit_rigid(
        [signals.prepare_motor_signals(log, Arm.of(study.arm))], Arm.of(study.arm)
    )
    return {(p.name, p.joint): p.value for p in model.parameters if p.value is not None}


def _error(values: Values, true_values: Values) -> float:
    errors = [values[key] / true_values[key] - 1.0 for key in values if key[0] in COMPARED]
    return max(map(abs, errors))
