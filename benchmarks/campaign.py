"""Cost of a campaign in addition to its identifications.

    python -m benchmarks.campaign [--studies N] [--dask-tasks N]

All rows are measured, except the two for a thousand cores, which are computed from them.
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
from rich.table import Table

from benchmarks.console import Console
from strainwave import pipeline
from strainwave.fleet.campaign import Settings, run
from strainwave.fleet.campaign.records import PARAMETERS_SCHEMA, RUNS_SCHEMA, RunRecord
from strainwave.fleet.campaign.store import Store
from strainwave.numerics.parallel import configure_process

SMALL_ARM = Path(__file__).resolve().parents[1] / "tests" / "data" / "small-arm"
CORES = 1000  # of the projection
STUDY_TIME = 5.0  # [s] of one core, typical of a whole-arm fit to short records
ROWS = 10_000  # of the measured store


@dataclass(frozen=True)
class Figure:
    """A measured or computed figure."""

    name: str
    value: float
    unit: str


def copy_studies(folder: Path, count: int) -> list[Path]:
    """Copies of the small arm of the tests."""
    studies = []
    for number in range(count):
        copy = folder / "rigs" / f"rig-{number:04d}"
        copy.mkdir(parents=True)
        for path in SMALL_ARM.glob("*.parquet"):
            (copy / path.name).symlink_to(path)
        (copy / "study.toml").write_bytes((SMALL_ARM / "study.toml").read_bytes())
        studies.append(copy / "study.toml")
    return studies


def time_identify(studies: list[Path]) -> float:
    """Mean time of one identification in this process [s]."""
    configure_process()
    pipeline.identify(studies[0], stages=("rigid",), threads=1)
    times = []
    for path in studies:
        begin = time.perf_counter()
        pipeline.identify(path, stages=("rigid",), threads=1)
        times.append(time.perf_counter() - begin)
    return statistics.fmean(times)


def time_campaign(studies: list[Path], folder: Path, workers: int) -> tuple[float, float]:
    """Time of a campaign without the start of processes, and mean time of its runs [s]."""
    store = folder / f"store-{workers}"
    settings = Settings(store=str(store), stages=("rigid",), workers=workers)
    summary = run([str(path) for path in studies], settings)
    assert summary.tally.by_status.total() == len(studies)
    table = Store(store).table("runs", ["started", "seconds"]).to_pylist()
    first = min(row["started"] for row in table)
    last = max(row["started"] + timedelta(seconds=row["seconds"]) for row in table)
    return (last - first).total_seconds(), statistics.fmean(row["seconds"] for row in table)


def store_times(folder: Path) -> list[Figure]:
    """Times to write a run, to list ten thousand, and to merge the last thousand."""
    store = Store(folder / "rows")
    day = datetime(2026, 1, 1)

    def record(number: int) -> RunRecord:
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
        return RunRecord(row, parameters, b"x" * 200_000)

    merged = [record(number) for number in range(ROWS - 1000)]
    for kind, schema in (("runs", RUNS_SCHEMA), ("parameters", PARAMETERS_SCHEMA)):
        rows = [entry.row for entry in merged]
        if kind == "parameters":
            rows = [row for entry in merged for row in entry.parameters]
        (folder / "rows" / kind).mkdir(parents=True)
        table = pa.Table.from_pylist(rows, schema=schema)
        pq.write_table(table, folder / "rows" / kind / "part-first.parquet")
    begin = time.perf_counter()
    for number in range(ROWS - 1000, ROWS):
        store.write(record(number))
    write_time = (time.perf_counter() - begin) / 1000
    list_time = _least_time(lambda: Store(folder / "rows").table("runs"))
    query_time = _least_time(lambda: Store(folder / "rows").recorded(f"{17:032x}"))
    begin = time.perf_counter()
    store.merge()
    merge_time = time.perf_counter() - begin
    merged_list_time = _least_time(lambda: Store(folder / "rows").table("runs"))
    return [
        Figure("writing a run: row, 26 parameters, result.json of 200 kB", 1e3 * write_time, "ms"),
        Figure("listing 10,000 runs, the last 1,000 not merged yet", list_time, "s"),
        Figure("listing 10,000 runs, merged", merged_list_time, "s"),
        Figure("asking a store opened anew for one of 10,000 runs", query_time, "s"),
        Figure("merging 1,000 runs into 9,000", merge_time, "s"),
    ]


def _least_time(work: Callable[[], object], repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def empty_task(line: str, limits: dict[str, object], since: str) -> str:
    """A Dask task with the arguments of a study's task, without work."""
    return line[:0] + since[:0]


def dask_overhead(count: int) -> float:
    """Time per empty task, submitted and gathered as in a campaign [s]."""
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
                client.submit(empty_task, line, {}, "warm", pure=False).result()
                begin = time.perf_counter()
                futures = [
                    client.submit(empty_task, line, {}, "", pure=False) for _ in range(count)
                ]
                client.gather(futures)
                return (time.perf_counter() - begin) / count
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait()


def measure(studies: int, dask_tasks: int) -> list[Figure]:
    with tempfile.TemporaryDirectory(prefix="strainwave-") as name:
        folder = Path(name)
        copies = copy_studies(folder, studies)
        single = time_identify(copies)
        one, run_time = time_campaign(copies, folder, 1)
        two, run_time_of_two = time_campaign(copies, folder, 2)
        rows = store_times(folder)
    overhead = one / studies - run_time  # between two runs
    task = dask_overhead(dask_tasks)
    # a core works on a study or for the campaign; one scheduler serves all cores
    by_core = STUDY_TIME / (STUDY_TIME + overhead)
    by_scheduler = min(1.0, STUDY_TIME / task / CORES)
    return [
        Figure("identification alone, stages rigid", 1e3 * single, "ms"),
        Figure("the same in a campaign, by its row (1 worker)", 1e3 * run_time, "ms"),
        Figure("the same in a campaign, by its row (2 workers)", 1e3 * run_time_of_two, "ms"),
        Figure("campaign, 1 worker", studies / one, "runs/s"),
        Figure("campaign, 2 workers", studies / two, "runs/s"),
        Figure("efficiency of 2 workers against 1", 100.0 * one / two / 2.0, "%"),
        Figure("overhead per run, between two of one worker", 1e3 * overhead, "ms"),
        *rows,
        Figure("Dask, an empty task", 1e3 * task, "ms"),
        Figure(
            f"projected efficiency of {CORES} cores, {STUDY_TIME:g} s per study",
            100.0 * min(by_core, by_scheduler),
            "%",
        ),
        Figure(
            f"cores that one scheduler keeps busy, {STUDY_TIME:g} s per study",
            STUDY_TIME / task,
            "",
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=40)
    parser.add_argument("--dask-tasks", type=int, default=3000)
    options = parser.parse_args()
    table = Table("what", "", box=None, pad_edge=False)
    table.columns[1].justify = "right"
    load = os.getloadavg()[0]
    for figure in measure(options.studies, options.dask_tasks):
        table.add_row(figure.name, f"{figure.value:.3g} {figure.unit}")
    table.add_row("system load before", f"{load:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
