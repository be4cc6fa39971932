"""A Dask scheduler and its workers, one process each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PATIENCE = 300.0  # [s]; a loaded machine is several times slower
QUIET = {"DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}


@dataclass
class Dask:
    """A scheduler and its workers, one process each."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def dask(folder: Path, workers: int = 2) -> Iterator[Dask]:
    file = folder / "scheduler.json"
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    processes: list[subprocess.Popen[bytes]] = []

    def start(kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        line = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *common, *arguments]
        environment = os.environ | QUIET | {"PYTHONWARNINGS": "ignore"}
        with (folder / f"{kind}-{len(processes)}.txt").open("w") as errors:
            process = subprocess.Popen(line, cwd=folder, env=environment, stderr=errors)
        processes.append(process)
        return process

    try:
        scheduler = start("scheduler", "--port", "0", "--host", "127.0.0.1")
        threads = ["--nthreads", "1", "--no-nanny"]
        started = [start("worker", *threads, "--name", str(n)) for n in range(workers)]
        until = time.monotonic() + PATIENCE
        while not file.exists():
            late = scheduler.poll() is not None or time.monotonic() > until
            assert not late, (folder / "scheduler-0.txt").read_text()
            time.sleep(0.05)
        yield Dask(json.loads(file.read_text())["address"], scheduler, started)
    finally:
        for process in processes:
            process.kill()
            process.wait()
