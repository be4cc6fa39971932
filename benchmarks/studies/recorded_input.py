"""Recorded voltages or the servo's loop: `python -m benchmarks.studies.recorded_input --arms 20`.

Each arm's records are fitted twice. Servoed joints are driven by their recorded inputs, or
follow their references under the study's servo. Printed are the errors of both, by parameter.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies.arms import each, with_logs
from strainwave import pipeline
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import TuningOptions, tune
from strainwave.io import logs
from strainwave.io.study import read_study
from strainwave.virtual.experiments import derived

WAYS = {"recorded voltages": False, "closed loop": True}


def tried(path: Path, values: Values) -> dict[str, Any]:
    """Relative errors and deviations both ways."""
    study = read_study(path)
    all_logs = logs.read_logs(study)
    known = derived(values, study.arm)
    before = pipeline.identify(path, stages=("rigid", "decoupled"))
    found: dict[str, Any] = {}
    for way, closed in WAYS.items():
        options = TuningOptions(closed_loop=closed)
        model = tune(all_logs, before.rigid, before.joints, Arm.of(study.arm), options)
        found[way] = {
            f"{p.name} {p.joint or ''}".strip(): [p.value / true - 1.0, p.std / abs(true)]
            for p in model.parameters
            if p.value is not None
            and p.std is not None
            and (true := known.get((p.name, p.joint), 0.0)) != 0.0
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    errors: dict[str, dict[str, list[list[float]]]] = {way: defaultdict(list) for way in WAYS}
    for found in each(chosen.arms, partial(with_logs, work=tried), chosen.out):
        for way in WAYS:
            for name, pair in found.get(way, {}).items():
                errors[way][name].append(pair)
    heads = [f"{what}, {way}" for way in WAYS for what in ("rms error %", "told +- %")]
    table = Table("parameter", *heads, box=None)
    for name in errors["recorded voltages"]:
        cells = []
        for way in WAYS:
            pairs = np.array(errors[way].get(name) or [[np.nan, np.nan]])
            cells += [np.sqrt(np.mean(pairs[:, 0] ** 2)), np.median(pairs[:, 1])]
        table.add_row(name, *(f"{100.0 * cell:.3g}" for cell in cells))
    Console().print(table)


if __name__ == "__main__":
    main()
