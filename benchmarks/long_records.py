"""Time and memory of stages over the length of records: `python -m benchmarks.long_records`.

PRBS records of 16, 65 and 262 thousand rows of the built-in arm, with both joints servoed so that
angles stay bounded. Each length runs in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.console import Console
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
result = identify(Path(sys.argv[1]), stages=sys.argv[2].split(","))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
values = {f"{p.name} {p.joint or ''}".strip(): p.value for p in result.parameters}
used = time.process_time() - begin
print(json.dumps({"timing": result.timing_s, "peak": peak, "used": used, "values": values}))
"""


def servoed_study(periods: int) -> Study:
    """The built-in rig's motion, and a PRBS of some periods on each joint."""
    study = scara.STIFF.study(Path(), "linear")
    experiments: list[Experiment] = []
    for experiment in study.experiments:
        if experiment.use == "motion":
            experiments.append(experiment)
        elif experiment.use == "frequency":
            prbs = Prbs(order=10, clock=1e-3, periods=periods, amplitude=8.0)
            experiments.append(replace(experiment, control=("servo", "servo"), prbs=prbs))
    return replace(study, experiments=tuple(experiments))


def measure(periods: int, stages: str) -> dict[str, object]:
    """Times, memory and values for one length."""
    study = servoed_study(periods)
    with TemporaryDirectory() as folder:
        values = scara.STIFF.parameters(spring="linear")
        simulate_study(study, values, Path(folder), noise=SensorNoise(), as_recorded=False)
        command = [sys.executable, "-c", _ONE, str(Path(folder) / "study.toml"), stages]
        process = subprocess.run(command, check=True, capture_output=True, text=True)
    figures: dict[str, object] = json.loads(process.stdout.splitlines()[-1])
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--periods", type=int, nargs="*", default=list(PERIODS))
    parser.add_argument("--stages", default="rigid,decoupled")
    parser.add_argument("--values", action="store_true", help="print the estimates")
    options = parser.parse_args()
    names = ["read", *options.stages.split(",")]
    table = Table("rows per record", *(f"{name} [s]" for name in names), box=None)
    table.add_column("processor [s]")
    table.add_column("peak memory [MB]")
    console = Console()
    for periods in options.periods:
        figures = measure(periods, options.stages)
        timing = figures["timing"]
        assert isinstance(timing, dict)
        cells = [f"{timing.get(name, float('nan')):.2f}" for name in names]
        peak, used = float(str(figures["peak"])), float(str(figures["used"]))
        table.add_row(f"{periods * 4092}", *cells, f"{used:.2f}", f"{peak / 1e6:.0f}")
        if options.values:
            console.print(figures["values"])
    console.print(table)


if __name__ == "__main__":
    main()
