"""The command `strainwave campaign` as a process."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

import strainwave as sw
from strainwave.fleet.campaign.store import Store

COUNT = 16
PATIENCE = 300.0  # [s]; a loaded machine is several times slower


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "strainwave", "campaign", *map(str, arguments)]


def campaign(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments, "--stages", "rigid"), capture_output=True, text=True, check=False
    )


@contextmanager
def running(*arguments: str | Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        command(*arguments, "--stages", "rigid"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as driver:
        try:
            yield driver
        finally:
            driver.kill()


def wait_for(store: Path, count: int, driver: subprocess.Popen[str]) -> None:
    """Wait until a number of runs is recorded by a driver."""
    until = time.monotonic() + PATIENCE
    while (recorded := Store(store).table("runs", ["run"]).num_rows) < count:
        assert driver.poll() is None, driver.communicate()
        assert time.monotonic() < until, f"{recorded} of {count} runs"
        time.sleep(0.02)


def workers_of(driver: subprocess.Popen[str]) -> list[psutil.Process]:
    return [
        p for p in psutil.Process(driver.pid).children() if "strainwave" in " ".join(p.cmdline())
    ]


def records_by_study(store: Path) -> Counter[str]:
    """Number of records of each study over all files of a store."""
    return Counter(sw.read_runs(store)["study"].to_pylist())
