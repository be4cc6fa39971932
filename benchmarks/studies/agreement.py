"""Agreement of rigid and whole-arm values: `python -m benchmarks.studies.agreement`.

`identify` runs on a motion and a PRBS per joint of the built-in arm with linear gears, unchanged
and with an alteration that no single stage detects. Printed are chi-square tests of the
differences, of all values and by groups, as standard deviations of a normal variable of the same
probability.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from strainwave.domain import FloatArray, Identification, Prbs, Study
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

Change = Callable[[str, str, FloatArray], FloatArray]
"""Altered samples, from an experiment's use, a channel and its samples."""

_DISKS = 5  # payload [kg]
_DEAD_ZONE = 0.15  # [V]
_CLOCK = 1.01  # factor of all stamps
_STRIBECK = 0.3  # Stribeck over Coulomb friction
_STRIBECK_VELOCITY = 3.0  # [rad/s] motor side


def _unchanged(_use: str, _name: str, x: FloatArray) -> FloatArray:
    return x


def _falling_torque_constant(share: float) -> Change:
    """Voltages of a motor whose torque constant falls by a share at 10 V."""

    def change(_use: str, name: str, x: FloatArray) -> FloatArray:
        if not name.startswith("u"):
            return x
        slope = 0.1 * share  # the arm was driven by v = u (1 - slope |u|)
        return np.asarray(np.sign(x) * (1.0 - np.sqrt(1.0 - 4.0 * slope * np.abs(x))) / (2 * slope))

    return change


def _dead_zone(_use: str, name: str, x: FloatArray) -> FloatArray:
    return x + _DEAD_ZONE * np.sign(x) if name.startswith("u") else x


def _fast_clock(_use: str, name: str, x: FloatArray) -> FloatArray:
    return _CLOCK * x if name == "t" else x


def _fast_clock_of_prbs_records(use: str, name: str, x: FloatArray) -> FloatArray:
    return x if use == "motion" else _fast_clock(use, name, x)


CASES: dict[str, tuple[bool, Change]] = {
    "unchanged": (False, _unchanged),
    "motor constants fall by 10 % at 10 V": (False, _falling_torque_constant(0.10)),
    "by 5 %": (False, _falling_torque_constant(0.05)),
    "dead zone of 0.15 V": (False, _dead_zone),
    "Stribeck friction of 0.3 of Coulomb's": (True, _unchanged),
    "clock of all records 1 % fast": (False, _fast_clock),
    "clock of the PRBS records 1 % fast": (False, _fast_clock_of_prbs_records),
}
"""Whether the arm has Stribeck friction that its study does not name, and the alteration."""


def simulate_arm(folder: Path, seed: int, *, stribeck: bool) -> Study:
    """Simulate the records of one arm; its study names no effect."""
    study, values = scara.STIFF.study(Path(), "linear"), scara.STIFF.parameters(_DISKS, "linear")
    experiments = [e for e in study.experiments if e.use in ("motion", "frequency")]
    short = Prbs(10, 1e-3, 1, 10.0)
    experiments = [replace(e, prbs=short) if e.use == "frequency" else e for e in experiments]
    true = study = replace(study, experiments=tuple(experiments))
    if stribeck:
        true = replace(
            true,
            arm=replace(
                true.arm, joints=tuple(replace(j, effects=("stribeck",)) for j in true.arm.joints)
            ),
        )
        for i in (1, 2):
            values["stribeck_friction", i] = _STRIBECK * values["motor_coulomb_friction", i]
            values["stribeck_velocity", i] = _STRIBECK_VELOCITY
    simulate_study(true, values, folder, seed=seed, noise=SensorNoise(), as_recorded=False)
    written = read_study(folder / "study.toml")
    return replace(written, arm=replace(written.arm, joints=study.arm.joints))


def identify_altered(study: Study, change: Change) -> Identification:
    """Run all stages on a study's records with every channel altered."""
    with TemporaryDirectory() as folder:
        for log in read_logs(study):
            columns = {"t": log.time, **log.channels}
            use = log.experiment.use
            columns = {name: change(use, name, x) for name, x in columns.items()}
            write_log(Path(folder) / log.experiment.file, columns)
        copy = replace(study, path=Path(folder) / "study.toml")
        write_study(copy, copy.path)
        return identify(copy.path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    table = Table("arm", "seed", "all", "inertias", "friction 1", "friction 2", "status", box=None)
    for name, (stribeck, change) in CASES.items():
        for seed in range(options.seeds):
            with TemporaryDirectory() as folder:
                result = identify_altered(
                    simulate_arm(Path(folder), seed, stribeck=stribeck), change
                )
            tests = result.whole_arm.agreement if result.whole_arm else ()
            cells = [f"{test.deviations:.1f}" for test in tests] or [""] * 4
            codes = [suspicion.code for suspicion in result.suspected]
            codes += [
                w.code
                for w in result.warnings
                if w.code == "stages-disagree" or w.code.endswith("-likely")
            ]
            table.add_row(name, str(seed), *cells, ", ".join([result.verdict.status, *codes]))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
