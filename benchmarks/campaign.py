"""What a campaign costs beyond its identifications, and what that makes of a thousand cores.

    python -m benchmarks.campaign [--studies N] [--dask-tasks N]

Each row is measured here, but for the last, which follows from the others.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from strainwave import pipeline
from strainwave.campaign import Settings, run
from strainwave.campaign.schema import PARAMETERS, RUNS
from strainwave.campaign.store import Record, Store
from strainwave.numerics.parallel import own_process

SMALL_ARM = Path(__file__).resolve().parents[1] / "tests" / "data" / "small-arm"
CORES = 1000
TYPICAL = 5.0  # [s] of one core for a whole-arm fit to short records
ROWS = 10_000


@dataclass(frozen=True)
class Measured:
    """A figure and what it is."""

    what: str
    value: float
    unit: str


def rigs(folder: Path, count: int) -> list[Path]:
    """The small arm of the tests, as many times."""
    made = []
    for number in range(count):
        own = folder / "rigs" / f"rig-{number:04d}"
        own.mkdir(parents=True)
        for path in SMALL_ARM.glob("*.parquet"):
            (own / path.name).symlink_to(path)
        (own / "study.toml").write_bytes((SMALL_ARM / "study.toml").read_bytes())
        made.append(own / "study.toml")
    return made


def alone(studies: list[Path]) -> float:
    """Time of one identification in this process [s]."""
    own_process()
    pipeline.identify(studies[0], stages=("rigid",), threads=1)
    times = []
    for path in studies:
        begin = time.perf_counter()
        pipeline.identify(path, stages=("rigid",), threads=1)
        times.append(time.perf_counter() - begin)
    return statistics.fmean(times)


def campaigns(studies: list[Path], folder: Path, workers: int) -> tuple[float, float]:
    """Time of a campaign, and the mean that its runs report, without the start of processes [s]."""
    store = folder / f"store-{workers}"
    settings = Settings(store=str(store), stages=("rigid",), workers=workers)
    summary = run([str(path) for path in studies], settings)
    assert summary.tally.by_status.total() == len(studies)
    table = Store.at(store).table("runs", ["started", "seconds"]).to_pylist()
    first = min(row["started"] for row in table)
    last = max(row["started"] + timedelta(seconds=row["seconds"]) for row in table)
    return (last - first).total_seconds(), statistics.fmean(row["seconds"] for row in table)


def store_times(folder: Path) -> list[Measured]:
    """Of one run written, of ten thousand listed while the last thousand are small, and merged."""
    store = Store.at(folder / "rows")
    day = datetime(2026, 1, 1)

    def record(number: int) -> Record:
        run_name = f"{number:032x}"
        row: dict[str, Any] = {
            "run": run_name,
            "study": f"rigs/{number}/study.toml",
            "status": "determined",
        }
        row |= {"started": day + timedelta(seconds=number), "exit_code": 0, "message": ""}
        keys = {"run": run_name, "study": row["study"], "unit": "kg m^2", "stage": "tuned"}
        names = [f"parameter_{k}" for k in range(26)]
        parameters = [keys | {"name": name, "joint": 1, "value": 1.0} for name in names]
        return Record(row, parameters, b"x" * 200_000)

    merged = [record(number) for number in range(ROWS - 1000)]
    for kind, schema in (("runs", RUNS), ("parameters", PARAMETERS)):
        rows = [each.row for each in merged]
        if kind == "parameters":
            rows = [row for each in merged for row in each.parameters]
        (folder / "rows" / kind).mkdir(parents=True)
        table = pa.Table.from_pylist(rows, schema=schema)
        pq.write_table(table, folder / "rows" / kind / "part-first.parquet")
    begin = time.perf_counter()
    for number in range(ROWS - 1000, ROWS):
        store.write(record(number))
    written = (time.perf_counter() - begin) / 1000
    listed = _best(lambda: Store.at(folder / "rows").table("runs"))
    known = _best(lambda: Store.at(folder / "rows").recorded(f"{17:032x}"))
    begin = time.perf_counter()
    store.merge()
    merging = time.perf_counter() - begin
    after = _best(lambda: Store.at(folder / "rows").table("runs"))
    return [
        Measured("writing a run: row, 26 parameters, result.json of 200 kB", 1e3 * written, "ms"),
        Measured("listing 10,000 runs, the last 1,000 not merged yet", listed, "s"),
        Measured("listing 10,000 runs, merged", after, "s"),
        Measured("asking a store opened anew for one of 10,000 runs", known, "s"),
        Measured("merging 1,000 runs into 9,000", merging, "s"),
    ]


def _best(work: Callable[[], object], repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def nothing(line: str, limits: dict[str, object], since: str) -> str:
    """A Dask task that does nothing with what a study's task is given."""
    return line[:0] + since[:0]


def dask_overhead(count: int) -> float:
    """Time per task that does nothing, submitted and gathered as a campaign does [s]."""
    from distributed import Client

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        common = ["--scheduler-file", str(file), "--no-dashboard"]
        kinds = {"scheduler": ["--port", "0"], "worker": ["--nthreads", "2", "--no-nanny"]}
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{kind}", *common, *more],
                stderr=subprocess.DEVNULL,
                cwd=folder,
            )
            for kind, more in kinds.items()
        ]
        try:
            while not file.exists():
                time.sleep(0.05)
            with Client(scheduler_file=str(file), set_as_default=False) as client:
                client.wait_for_workers(1)
                line = "x" * 600  # characters of a task
                client.submit(nothing, line, {}, "warm", pure=False).result()
                begin = time.perf_counter()
                futures = [client.submit(nothing, line, {}, "", pure=False) for _ in range(count)]
                client.gather(futures)
                return (time.perf_counter() - begin) / count
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait()


def measured(studies: int, dask_tasks: int) -> list[Measured]:
    with tempfile.TemporaryDirectory(prefix="strainwave-") as name:
        folder = Path(name)
        made = rigs(folder, studies)
        single = alone(made)
        one, inside = campaigns(made, folder, 1)
        two, inside_two = campaigns(made, folder, 2)
        rows = store_times(folder)
    overhead = one / studies - inside  # what lies between two runs
    task = dask_overhead(dask_tasks)
    # a core works on a study or for the campaign; the scheduler serves all cores by itself
    by_core = TYPICAL / (TYPICAL + overhead)
    by_scheduler = min(1.0, TYPICAL / task / CORES)
    return [
        Measured("identification alone, stages rigid", 1e3 * single, "ms"),
        Measured("the same in a campaign, by its row (1 worker)", 1e3 * inside, "ms"),
        Measured("the same in a campaign, by its row (2 workers)", 1e3 * inside_two, "ms"),
        Measured("campaign, 1 worker", studies / one, "runs/s"),
        Measured("campaign, 2 workers", studies / two, "runs/s"),
        Measured("efficiency of 2 workers against 1", 100.0 * one / two / 2.0, "%"),
        Measured("overhead per run, between two of one worker", 1e3 * overhead, "ms"),
        *rows,
        Measured("Dask, a task that does nothing", 1e3 * task, "ms"),
        Measured(
            f"projected efficiency of {CORES} cores, {TYPICAL:g} s a study",
            100.0 * min(by_core, by_scheduler),
            "%",
        ),
        Measured(f"cores that one scheduler keeps busy, {TYPICAL:g} s a study", TYPICAL / task, ""),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=40)
    parser.add_argument("--dask-tasks", type=int, default=3000)
    given = parser.parse_args()
    table = Table("what", "", box=None, pad_edge=False)
    table.columns[1].justify = "right"
    load = os.getloadavg()[0]
    for row in measured(given.studies, given.dask_tasks):
        table.add_row(row.what, f"{row.value:.3g} {row.unit}")
    table.add_row("load of the machine before", f"{load:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
