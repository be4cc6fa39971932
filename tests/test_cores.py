"""Independent work, side by side."""

from __future__ import annotations

import os
import threading
from functools import partial

import pytest

from strainwave.cores import side_by_side


def test_results_come_in_order() -> None:
    assert side_by_side([partial(pow, k, 2) for k in range(7)]) == [0, 1, 4, 9, 16, 25, 36]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is but one core")
def test_jobs_run_at_the_same_time() -> None:
    both = threading.Barrier(2, timeout=30.0)

    def meet() -> bool:
        both.wait()  # breaks unless the other comes
        return True

    assert side_by_side([meet, meet]) == [True, True]


def test_a_job_that_fails_tells_who_asks() -> None:
    def job() -> int:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        side_by_side([lambda: 3, job])
