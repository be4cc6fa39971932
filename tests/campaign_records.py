"""Rows of synthetic runs, and a process that writes many of them."""

from __future__ import annotations

from datetime import datetime, timedelta

from strainwave.fleet.campaign.records import RunRecord
from strainwave.fleet.campaign.store import Store

DAY = datetime(2026, 1, 1)


def record(run: str, seconds: float = 0.0, status: str = "determined") -> RunRecord:
    row = {"run": run, "study": f"{run}/study.toml", "status": status, "exit_code": 0}
    row |= {"started": DAY + timedelta(seconds=seconds), "message": "", "seconds": 1.0}
    parameters = [
        {"run": run, "study": row["study"], "name": name, "joint": joint, "value": 1.5}
        for name, joint in (("beta", None), ("motor_inertia", 1), ("motor_inertia", 2))
    ]
    return RunRecord(row, parameters, b"{}")


def write_many(folder: str, first: int, count: int) -> None:
    """Write runs and merge them at times, as one of several processes."""
    store = Store(folder)
    for number in range(first, first + count):
        store.write(record(f"run-{number:05d}", number))
        if number % 10 == 0:
            store.merge()
