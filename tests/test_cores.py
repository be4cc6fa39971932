"""Independent work: side by side, and begun ahead of what asks for it."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from strainwave.cores import begin, side_by_side


def test_results_come_in_order() -> None:
    assert side_by_side([partial(pow, k, 2) for k in range(7)]) == [0, 1, 4, 9, 16, 25, 36]


def test_what_is_begun_runs_behind_its_caller() -> None:
    gate = threading.Event()

    def job() -> int:
        assert gate.wait(timeout=30.0)
        return 3

    (begun,) = begin([job])
    assert not begun.done()  # it waits for us, not we for it
    gate.set()
    assert begun.result() == 3


def test_a_job_that_fails_tells_who_asks() -> None:
    def job() -> None:
        raise ValueError("no")

    (begun,) = begin([job])
    with pytest.raises(ValueError, match="no"):
        begun.result()
