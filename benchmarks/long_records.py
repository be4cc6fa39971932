"""How stages grow with a record's length: `python -m benchmarks.long_records`.

PRBS records of 16, 65 and 262 thousand rows on the built-in arm, both joints held by their servos
so that the angles stay bounded. Of each length, in a process of its own: the seconds of each
stage, processor time, and the largest resident memory.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

from strainwave.domain import Experiment, Prbs, Study
from strainwave.dynamics.simulation import SensorNoise
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

PERIODS = (4, 16, 64)  # of 1.023 s at 4 kHz

_ONE = """
import json, resource, sys, time
from pathlib import Path
from strainwave.pipeline import identify
begin = time.process_time()
found = identify(Path(sys.argv[1]), stages=sys.argv[2].split(","))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
values = {f"{p.name} {p.joint or ''}".strip(): p.value for p in found.parameters}
used = time.process_time() - begin
print(json.dumps({"timing": found.timing_s, "peak": peak, "used": used, "values": values}))
"""


def held(periods: int) -> Study:
    """The built-in rig's study: its motion, and a PRBS of some periods on either joint."""
    whole = scara.study(Path(), "linear")
    kept: list[Experiment] = []
    for own in whole.experiments:
        if own.use == "motion":
            kept.append(own)
        elif own.use == "frequency":
            prbs = Prbs(order=10, clock=1e-3, periods=periods, amplitude=8.0)
            kept.append(replace(own, control=("servo", "servo"), prbs=prbs))
    return replace(whole, experiments=tuple(kept))


def measured(periods: int, stages: str) -> dict[str, object]:
    """Times, memory and values of one length."""
    study = held(periods)
    with TemporaryDirectory() as folder:
        values = scara.parameters(spring="linear")
        simulate_study(study, values, Path(folder), noise=SensorNoise(), as_recorded=False)
        command = [sys.executable, "-c", _ONE, str(Path(folder) / "study.toml"), stages]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--periods", type=int, nargs="*", default=list(PERIODS))
    parser.add_argument("--stages", default="rigid,decoupled")
    parser.add_argument("--values", action="store_true", help="print what was estimated")
    chosen = parser.parse_args()
    names = ["read", *chosen.stages.split(",")]
    table = Table("rows a record", *(f"{name} [s]" for name in names), box=None)
    table.add_column("processor [s]")
    table.add_column("peak memory [MB]")
    console = Console()
    for periods in chosen.periods:
        found = measured(periods, chosen.stages)
        timing = found["timing"]
        assert isinstance(timing, dict)
        cells = [f"{timing.get(name, float('nan')):.2f}" for name in names]
        peak, used = float(str(found["peak"])), float(str(found["used"]))
        table.add_row(f"{periods * 4092}", *cells, f"{used:.2f}", f"{peak / 1e6:.0f}")
        if chosen.values:
            console.print(found["values"])
    console.print(table)


if __name__ == "__main__":
    main()
