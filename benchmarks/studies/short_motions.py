"""Healthy arms that move for 6 s: `python -m benchmarks.studies.short_motions --arms 200`.

Short motions hardly tell joints, delays and friction apart, so they are where an input check
accuses wrongly. Every suspicion is printed with its arm's number.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from rich.console import Console

from strainwave.domain import Suspicion
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.io.logs import read_logs
from strainwave.signals.consistency import check
from strainwave.virtual.families import catalogue
from strainwave.virtual.families.short_records import plans, with_short_records
from strainwave.virtual.records import recorded

_SERIES = 7500  # of the catalogue
_MOTIONS = 500_000  # seeds of motions, from here on
_UPRIGHT = 3  # one arm in as many


def suspected(number: int) -> tuple[Suspicion, ...]:
    """What is said of an arm without a fault, by its motion alone."""
    rng = np.random.default_rng(number)
    drawn = catalogue.drawn(number, _SERIES)
    rig = with_short_records(drawn, upright=number % _UPRIGHT == 0, rng=rng)
    motion = rig.study.experiments[0]
    rig = replace(rig, study=replace(rig.study, experiments=(motion,)))
    arm = Arm.of(rig.study.arm)
    plan = plans(rig, _MOTIONS + number)[0]
    channels = recorded(rig.study, arm, plan, rig.values, rig.noise, rng, simulate)
    logs = read_logs(rig.study, data={motion.name: channels})
    return check(logs, rig.study).suspected


def main() -> None:
    """Print every suspicion, and how many arms have one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--first", type=int, default=1000, help="the first arm's number")
    chosen = parser.parse_args()
    console, accused = Console(), 0
    for number in range(chosen.first, chosen.first + chosen.arms):
        found = suspected(number)
        accused += bool(found)
        for each in found:
            console.print(f"{number}: {each.code}: {each.message}")
    console.print(f"{accused} of {chosen.arms} arms without a fault are suspected")


if __name__ == "__main__":
    main()
