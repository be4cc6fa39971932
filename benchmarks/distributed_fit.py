"""One evaluation of a large whole-arm fit, in two threads and on two Dask workers.

    python -m benchmarks.distributed_fit STUDY

STUDY is an arm whose derivatives have more than 256 MB, such as seven joints with IMUs. The fit is
stopped at its first evaluation with derivatives, which is then repeated at other points.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import psutil
from rich.table import Table

from benchmarks.console import Console
from strainwave import pipeline
from strainwave.domain import FloatArray
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.numerics.dask_cluster import Cluster, connected
from strainwave.numerics.parallel import configure_process, limited, one_blas_thread
from strainwave.numerics.search import Linearised

EVALUATIONS = 3


class Captured(BaseException):
    """The objective at the first evaluation of a large fit."""


def first_evaluation(study: Path) -> tuple[Objective, FloatArray]:
    linearise = Objective.linearise

    def captured(self: Objective, z: FloatArray) -> Linearised | None:
        if self._is_large:
            raise Captured(self, z)
        return linearise(self, z)

    try:
        with patch.object(Objective, "linearise", captured):
            pipeline.identify(study)
    except Captured as at:
        objective, z = at.args
        return objective, z
    sys.exit("the fit of this study is not large")


@contextmanager
def measured(table: Table, name: str, *groups: list[psutil.Process]) -> Iterator[None]:
    def times() -> list[float]:
        return [sum(sum(one.cpu_times()[:2]) for one in group) for group in groups]

    before, begin = times(), time.perf_counter()
    yield
    seconds = [time.perf_counter() - begin, *np.subtract(times(), before)]
    table.add_row(name, *(f"{each:.2f}" for each in seconds))


def main() -> None:
    configure_process()
    from distributed import LocalCluster

    objective, z = first_evaluation(Path(sys.argv[1]))
    table = Table("evaluation", "wall [s]", "processor, command [s]", "processor, workers [s]")
    points = [z + 1e-3 * k for k in range(EVALUATIONS + 1)]
    command, records = [psutil.Process()], len(objective.records)
    untouched = objective.replace_unknowns(objective.space)
    expected = {}
    with one_blas_thread():
        for k, point in enumerate(points):
            with measured(table, f"threads, {k}", command):
                expected[k] = objective.linearise(point)
        with measured(table, "threads, cost", command):
            objective.cost(z)
        objective = untouched
        with (
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as local,
            connected(local) as client,
        ):
            workers = [psutil.Process(pid) for pid in client.run(os.getpid).values()]
            with limited(cluster=Cluster(client)):
                for k, point in enumerate(points):
                    name = f"Dask, {k}" + (", records are sent" if k == 0 else "")
                    with measured(table, name, command, workers):
                        at = objective.linearise(point)
                    same = at and expected[k] and np.array_equal(at.factor, expected[k].factor)
                    table.add_row("", f"equal: {same}")
                with measured(table, "Dask, residuals", command, workers):
                    objective.rows(points[-1])
                with measured(table, "Dask, cost", command, workers):
                    objective.cost(z)
    Console().print(table)
    job = replace(objective.select_records(0), records=()), z, Objective._linearised_record
    sizes = {
        "records": sum(len(pickle.dumps(record)) for record in objective.records),
        "sent": records * len(pickle.dumps(job)),
        "received": records * expected[0].factor.nbytes if expected[0] else 0,
        "residuals": len(pickle.dumps(objective.rows(points[-1]))),
    }
    print(records, "records;", ", ".join(f"{k} {n / 1e6:.1f} MB" for k, n in sizes.items()))


if __name__ == "__main__":
    main()
