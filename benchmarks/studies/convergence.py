"""How often the whole-arm fit converges from far: `python -m benchmarks.studies.convergence`.

Each arm is fitted from the truth and from a start 30 % off in every parameter and 3 times off in
the gears' damping; home is where both ends are the same, to half of each parameter's deviation.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.studies.arms import each, with_logs
from strainwave import pipeline
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import tune
from strainwave.io import logs
from strainwave.io.study import read_study

OFF, FAR_OFF = 0.3, 3.0
SAME = 0.5  # of a standard deviation


def tried(path: Path, values: Values) -> dict[str, Any]:
    """How far the two ends lie apart, in deviations."""
    study = read_study(path)
    all_logs = logs.read_logs(study)
    before = pipeline.identify(path, stages=("rigid", "decoupled"))
    rng = np.random.default_rng(int(1e12 * values["motor_inertia", 1]))
    starts = values, _far_from(values, rng)
    ends = [
        tune(all_logs, before.rigid, before.joints, Arm.of(study.arm), start=start)
        for start in starts
    ]
    home = {(q.name, q.joint): q for q in ends[0].parameters if q.value is not None}
    apart = {
        f"{p.name} {p.joint or ''}".strip(): abs(p.value - q.value) / q.std
        for p in ends[1].parameters
        if (q := home.get((p.name, p.joint))) is not None
        and p.value is not None
        and q.value is not None
        and q.std
    }
    worst = max(apart, key=lambda name: apart[name])
    return {
        "worst": worst,
        "apart": apart[worst],
        "statuses": [end.status for end in ends],
        "iterations": [end.iterations for end in ends],
    }


def _far_from(values: Values, rng: np.random.Generator) -> Values:
    """A start whose inertia matrix is one in every posture."""
    while True:
        start = {key: value * _factor(key[0], rng) for key, value in values.items()}
        if start["alpha", None] * start["beta", None] > 1.02 * start["gamma", None] ** 2:
            return start


def _factor(name: str, rng: np.random.Generator) -> float:
    up = bool(rng.integers(2))
    if name == "gear_damping":
        return FAR_OFF if up else 1.0 / FAR_OFF
    return 1.0 + OFF if up else 1.0 - OFF


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    found = list(each(chosen.arms, partial(with_logs, work=tried), chosen.out))
    home = [one for one in found if one.get("apart", np.inf) < SAME]
    console = Console()
    console.print(f"{len(home)} of {len(found)} ended where the fit from the truth does")
    for one in found:
        if one not in home:
            console.print(one)


if __name__ == "__main__":
    main()
