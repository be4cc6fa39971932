"""Reading a study of about 10 MB of CSV, compared with pyarrow and NumPy.

The study is a simulation of the built-in arm.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.timing import Row, best_of
from strainwave.io import logs
from strainwave.io.study import read_study
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara


def rows() -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        study = scara.STIFF.study(Path(folder) / "x")
        csv = tuple(replace(e, file=f"{e.name}.csv") for e in study.experiments)
        target = Path(folder) / "study"
        virtual.simulate_study(replace(study, experiments=csv), scara.STIFF.parameters(), target)
        files = sorted(target.glob("*.csv"))
        size = sum(file.stat().st_size for file in files) / 1e6
        task = f"reading a study of {size:.1f} MB of CSV"
        time = best_of(lambda: _read_study(target), repeats=3)
        return [
            Row(task, time, "pyarrow, no checks", best_of(lambda: _pyarrow(files), repeats=3)),
            Row(task, time, "numpy.loadtxt", best_of(lambda: _loadtxt(files), repeats=1)),
        ]


def _read_study(folder: Path) -> None:
    logs.read_logs(read_study(folder / "study.toml"))


def _pyarrow(files: list[Path]) -> None:
    from pyarrow import csv

    for file in files:
        table = csv.read_csv(file)
        for column in table.columns:
            column.to_numpy()


def _loadtxt(files: list[Path]) -> None:
    for file in files:
        np.loadtxt(file, delimiter=",", skiprows=1)
