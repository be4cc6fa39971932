"""Time and peak memory of the rigid step over the length of its record.

A process of its own reads and fits one Parquet record of a planar arm. Both joints follow slow sums
of sines, so that motors reverse equally often per second in short and long records.

python -m benchmarks.bench_length 50000 500000 10000000
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.timing import Row
from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm

SIZES = (50_000, 500_000)
SAMPLE_TIME = 1e-3
COUNT = 2.0 * np.pi / 8192
TRUE_VALUES = np.array([3.0, 0.9, 0.65, 0.7, 0.05, 0.03])  # inertias [kg m^2], friction [N m]
RATIO = 0.01
STUDY = """\
[arm]
kind = "planar-two-link"
link_length = 0.35

[[joint]]
spring = "rigid"
gear_ratio = 0.01
encoder_counts = 8192

[[joint]]
spring = "rigid"
gear_ratio = 0.01
encoder_counts = 8192

[channels]
t = "t"
torque1 = "torque1"
torque2 = "torque2"
theta_m1 = "theta_m1"
theta_m2 = "theta_m2"

[[experiment]]
name = "long"
file = "long.parquet"
use = "motion"
control = ["servo", "servo"]
"""


def rows() -> list[Row]:
    """Time at each size; the peer is the first time, scaled by the number of rows."""
    runs = [measure(size) for size in SIZES]
    per_row = runs[0]["seconds"] / SIZES[0]
    return [
        Row(
            f"rigid step, {size:,} rows, {run['peak_mb']:.0f} MB in all",
            run["seconds"],
            f"in proportion to {SIZES[0]:,} rows",
            per_row * size,
        )
        for size, run in zip(SIZES, runs, strict=True)
    ]


def measure(n_rows: int) -> dict[str, float]:
    """Times [s], peak memory [MB] and largest error [%] of a process that fits one record."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), n_rows)
        command = [sys.executable, "-m", "benchmarks.bench_length", "--fit", folder]
        process = subprocess.run(command, check=True, capture_output=True, text=True)
        figures: dict[str, float] = json.loads(process.stdout)
        return figures


def write(folder: Path, n_rows: int) -> None:
    """Write a record of the arm and its study."""
    import pyarrow as pa
    from pyarrow import parquet

    (folder / "study.toml").write_text(STUDY)
    rng = np.random.default_rng(2009)
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 4))
    schema = pa.schema([(c, pa.float64()) for c in ("t", *_CHANNELS)])
    with parquet.ParquetWriter(folder / "long.parquet", schema) as writer:
        for start in range(0, n_rows, 1_000_000):
            t = np.asarray(np.arange(start, min(n_rows, start + 1_000_000)) * SAMPLE_TIME)
            columns = _channels(t, phase, rng)
            writer.write_table(pa.table([t, *columns], schema=schema))


_CHANNELS = ("torque1", "torque2", "theta_m1", "theta_m2")


def _channels(t: FloatArray, phase: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Torques with noise, and motor angles in counts."""
    q, dq, ddq = (np.zeros((2, len(t))) for _ in range(3))
    for i in (0, 1):
        for k, f in enumerate((0.11, 0.31, 0.73, 1.37)):
            w = 2.0 * np.pi * f * (1.0 + 0.13 * i)
            size = 0.6 / (1.0 + k)
            q[i] += size * np.sin(w * t + phase[i, k])
            dq[i] += size * w * np.cos(w * t + phase[i, k])
            ddq[i] -= size * w**2 * np.sin(w * t + phase[i, k])
    first, motor, beta, gamma, *coulomb = TRUE_VALUES
    cos, sin = np.cos(q[1]), np.sin(q[1])
    torque = [
        (first + beta + 2 * gamma * cos) * ddq[0]
        + (beta + gamma * cos) * ddq[1]
        - gamma * sin * dq[1] * (2 * dq[0] + dq[1]),
        (beta + gamma * cos) * ddq[0] + (motor + beta) * ddq[1] + gamma * sin * dq[0] ** 2,
    ]
    torque = [
        RATIO * x + f * np.sign(v) + 1e-3 * rng.normal(size=len(t))
        for x, f, v in zip(torque, coulomb, dq, strict=True)
    ]
    return [*torque, *(np.round(x / RATIO / COUNT) * COUNT for x in q)]


def _fit(folder: Path) -> None:
    from strainwave.identification import rigid
    from strainwave.io import logs
    from strainwave.io.study import read_study
    from strainwave.signals import motor as signals

    begin, cpu = time.perf_counter(), time.process_time()
    study = read_study(folder / "study.toml")
    (log,) = logs.read_logs(study)
    read = time.perf_counter()
    motion = signals.prepare_motor_signals(log, Arm.of(study.arm))
    del log
    model = rigid.fit_rigid([motion], Arm.of(study.arm))
    end = time.perf_counter()
    values = [model.value(name) for name in ("beta", "gamma")]
    errors = [abs((x or np.nan) / t - 1.0) for x, t in zip(values, TRUE_VALUES[2:4], strict=True)]
    figures = {
        "seconds": end - begin,
        "cpu_seconds": time.process_time() - cpu,
        "read_seconds": read - begin,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "error_percent": 100.0 * max(errors),
        "bandwidth_hz": model.bandwidth_hz,
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--fit"]:
        _fit(Path(sys.argv[2]))
    else:
        lengths = [(size, measure(size)) for size in map(int, sys.argv[1:] or SIZES)]
        table = Table("rows", *lengths[0][1], box=None)
        for size, figures in lengths:
            table.add_row(f"{size:,}", *(f"{x:.4g}" for x in figures.values()))
        Console().print(table)
