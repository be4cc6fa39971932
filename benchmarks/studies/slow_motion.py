"""Gear stiffness of drawn chains with encoders on both sides of their gears, from slow motion.

`python -m benchmarks.studies.slow_motion --chains 24` draws the chains of `drawn_chains` without
PRBS, steps and IMUs, and with a link encoder on each joint: four servoed motions at 1 kHz. Printed
are, per chain and in all, the errors of the stiffness and the share of 95 % intervals that contain
the true value.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.studies.arms import run_all
from benchmarks.studies.drawn_chains import Chain, draw_chain, identify_chain, silently_wrong
from strainwave.domain import Control, Experiment, Use

_SAMPLE_TIME = 1e-3  # [s]
_MOTIONS = 4


def slow_chain(seed: int, numbers: Sequence[int]) -> Chain:
    """The drawn chain of a seed with link encoders and slow motion."""
    chain = draw_chain(seed, numbers, ["encoder"])
    servo: Control = "servo"
    motion: Use = "motion"
    uses = (*[motion] * _MOTIONS, "check")
    experiments = tuple(
        Experiment(f"motion-{k}", f"motion-{k}.parquet", use, (servo,) * chain.study.arm.n_joints)
        for k, use in enumerate(uses, start=1)
    )
    study = replace(chain.study, experiments=experiments)
    return replace(chain, study=study, sample_time=_SAMPLE_TIME)


def evaluate(seed: int, numbers: Sequence[int]) -> dict[str, Any]:
    """Simulate and identify one chain; a failure is returned as a result."""
    return identify_chain(slow_chain(seed, numbers), seed, ("rigid", "decoupled"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chains", type=int, default=24)
    parser.add_argument("--joints", default="2,3,4,6", help="lengths of the chains, in turn")
    parser.add_argument("--at-once", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("build/slow-motion.jsonl"))
    options = parser.parse_args()
    work = partial(evaluate, numbers=[int(n) for n in options.joints.split(",")])
    options.out.parent.mkdir(parents=True, exist_ok=True)
    console, found, n_joints = Console(width=160), list[dict[str, Any]](), 0
    for row in run_all(range(options.chains), work, options.out, options.at_once):
        stiffness = [p for p in row.get("parameters", []) if p["name"] == "gear_stiffness"]
        found += stiffness
        n_joints += row["joints"]
        errors = ", ".join(f"{100.0 * p['error']:+.2f} ± {100.0 * p['std']:.2f}" for p in stiffness)
        outcome = row.get("failure") or f"{errors} %"
        wrong = "; ".join(silently_wrong(row))
        console.print(f"{row['seed']}: {row['joints']} joints, {row['engine']}: {outcome} {wrong}")
    sizes = 100.0 * np.abs([p["error"] for p in found])
    inside = share_of([p["inside"] for p in found])
    table = Table("joints", "with a stiffness", "inside", "median error", "largest", box=None)
    cells = (f"{np.median(sizes):.2f} %", f"{sizes.max():.1f} %")
    table.add_row(str(n_joints), str(len(found)), inside, *cells)
    console.print(table)


if __name__ == "__main__":
    main()
