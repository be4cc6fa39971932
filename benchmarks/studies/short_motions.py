"""False suspicions in short motions: `python -m benchmarks.studies.short_motions --arms 200`.

Arms without a fault move for 6 s. Short motions hardly separate joints, delays and friction, so
they are most likely to cause false suspicions. Each one is printed with its arm's number.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.families import catalogue
from benchmarks.families.catalogue import plans, with_short_records
from strainwave.domain import Suspicion
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.input_check import check_consistency
from strainwave.io.logs import read_logs
from strainwave.virtual.experiments import record_experiment

_SERIES = 7500  # of the catalogue
_FIRST_MOTION_SEED = 500_000
_VERTICAL_EVERY = 3  # arms


def suspected(number: int) -> tuple[Suspicion, ...]:
    """Suspicions about an arm without a fault, from its motion record."""
    rng = np.random.default_rng(number)
    rig = catalogue.drawn(number, _SERIES)
    rig = with_short_records(rig, upright=number % _VERTICAL_EVERY == 0, rng=rng)
    motion = rig.study.experiments[0]
    rig = replace(rig, study=replace(rig.study, experiments=(motion,)))
    arm = Arm.of(rig.study.arm)
    plan = plans(rig, _FIRST_MOTION_SEED + number)[0]
    channels = record_experiment(rig.study, arm, plan, rig.values, rig.noise, rng, simulate)
    logs = read_logs(rig.study, data={motion.name: channels})
    return check_consistency(logs, rig.study).suspected


def main() -> None:
    """Print every suspicion and the number of arms with one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--first", type=int, default=1000, help="the first arm's number")
    options = parser.parse_args()
    console, n_suspected = Console(), 0
    for number in range(options.first, options.first + options.arms):
        suspicions = suspected(number)
        n_suspected += bool(suspicions)
        for suspicion in suspicions:
            console.print(f"{number}: {suspicion.code}: {suspicion.message}")
    table = Table("arms without a fault", "suspected", box=None)
    table.add_row(str(options.arms), str(n_suspected))
    console.print(table)


if __name__ == "__main__":
    main()
