"""A worker process that fails in a way that the name of a study selects.

Run `python -m campaign_workers` instead of `python -m strainwave.fleet.campaign.worker`.
"""

from __future__ import annotations

import os
import signal
import time

from strainwave.fleet.campaign import worker
from strainwave.fleet.campaign.records import RunRecord, Task
from strainwave.fleet.campaign.study_files import StudyFile


def poisoned(task: Task) -> RunRecord:
    name = task.case.name
    if "exits" in name:
        os._exit(7)
    if "crashes" in name:
        os.kill(os.getpid(), signal.SIGSEGV)
    if "killed" in name:
        os.kill(os.getpid(), signal.SIGKILL)
    if "hangs" in name:
        time.sleep(3600.0)
    return worker.perform(task)


_whole = StudyFile.opened


class _Broken:
    """Object returned for a study whose name selects a failure."""

    def __enter__(self) -> None:
        raise ZeroDivisionError("a bug\nof two lines")

    def __exit__(self, *_: object) -> None:
        pass


class _Greedy(_Broken):
    def __enter__(self) -> None:
        bytearray(2**33)


def _opened(self: StudyFile) -> object:
    if "raises" in self.name:
        return _Broken()
    return _Greedy() if "hoards" in self.name else _whole(self)


if __name__ == "__main__":
    StudyFile.opened = _opened  # type: ignore[method-assign, assignment]
    worker.main(poisoned)
