"""What the stages say of one another on altered logs: `python -m benchmarks.studies.agreement`.

A slow motion and a PRBS on either joint of the built-in arm with linear gears go through
`identify` as they are, and with something changed that no single stage knows of. Shown is how far
the rigid and the whole-arm fit disagree, all values at once and by groups, in standard deviations
of a normal variable that is as unlikely as the chi-square.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from strainwave.domain import FloatArray, Identification, Prbs, Study
from strainwave.dynamics.simulation import SensorNoise
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

Change = Callable[[str, str, FloatArray], FloatArray]
"""Of an experiment's use, a channel and its samples, what stands in the altered log."""

_DISKS = 5
_DEAD_ZONE = 0.15  # [V]
_CLOCK = 1.01
_STRIBECK = 0.3  # of the Coulomb friction
_STRIBECK_VELOCITY = 3.0  # [rad/s] of the motor


def _as_it_is(_use: str, _name: str, x: FloatArray) -> FloatArray:
    return x


def _weakening(share: float) -> Change:
    """The voltage that a motor would need whose constant falls by a share at 10 V."""

    def change(_use: str, name: str, x: FloatArray) -> FloatArray:
        if not name.startswith("u"):
            return x
        slope = 0.1 * share  # v = u (1 - slope |u|) is what the arm was given
        return np.asarray(np.sign(x) * (1.0 - np.sqrt(1.0 - 4.0 * slope * np.abs(x))) / (2 * slope))

    return change


def _dead_zone(_use: str, name: str, x: FloatArray) -> FloatArray:
    return x + _DEAD_ZONE * np.sign(x) if name.startswith("u") else x


def _fast_clock(_use: str, name: str, x: FloatArray) -> FloatArray:
    return _CLOCK * x if name == "t" else x


def _fast_clock_of_fast_records(use: str, name: str, x: FloatArray) -> FloatArray:
    return x if use == "motion" else _fast_clock(use, name, x)


CASES: dict[str, tuple[bool, Change]] = {
    "as it is": (False, _as_it_is),
    "motor constants fall by 10 % at 10 V": (False, _weakening(0.10)),
    "by 5 %": (False, _weakening(0.05)),
    "dead zone of 0.15 V": (False, _dead_zone),
    "Stribeck friction of 0.3 of Coulomb's": (True, _as_it_is),
    "clock of all records 1 % fast": (False, _fast_clock),
    "clock of the fast records 1 % fast": (False, _fast_clock_of_fast_records),
}
"""Whether the arm has Stribeck friction that its study does not name, and how logs are changed."""


def simulated(folder: Path, seed: int, *, stribeck: bool) -> Study:
    """The records of one arm and its study, which names no effect."""
    study, values = scara.study(Path(), "linear"), scara.parameters(_DISKS, "linear")
    kept = [e for e in study.experiments if e.use in ("motion", "frequency")]
    short = Prbs(10, 1e-3, 1, 10.0)
    kept = [replace(e, prbs=short) if e.use == "frequency" else e for e in kept]
    true = study = replace(study, experiments=tuple(kept))
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


def altered(study: Study, change: Change) -> Identification:
    """The whole of `identify` on a study's records, every channel and the time changed."""
    with TemporaryDirectory() as folder:
        for log in read_logs(study):
            columns = {"t": log.time, **log.channels}
            use = log.experiment.use
            changed = {name: change(use, name, x) for name, x in columns.items()}
            write_log(Path(folder) / log.experiment.file, changed)
        copy = replace(study, path=Path(folder) / "study.toml")
        write_study(copy, copy.path)
        return identify(copy.path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    chosen = parser.parse_args()
    table = Table("arm", "seed", "all", "inertias", "friction 1", "friction 2", "said", box=None)
    for name, (stribeck, change) in CASES.items():
        for seed in range(chosen.seeds):
            with TemporaryDirectory() as folder:
                found = altered(simulated(Path(folder), seed, stribeck=stribeck), change)
            tests = found.tuned.agreement if found.tuned else ()
            cells = [f"{test.deviations:.1f}" for test in tests] or [""] * 4
            codes = [one.code for one in found.suspected]
            codes += [
                w.code
                for w in found.warnings
                if w.code == "stages-disagree" or w.code.endswith("-likely")
            ]
            table.add_row(name, str(seed), *cells, ", ".join([found.verdict.status, *codes]))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
