"""Small studies on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray

STUDY = """\
[arm]
kind = "planar-two-link"
link_length = 0.35

[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.08
encoder_counts = 8192
accelerometer_distance = 0.33

[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.03

[servo]
kind = "pi-velocity"
period = 0.001
kp = [0.12, 0.1]
ki = [1.5, 1.5]
limit = 10.0

[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo", "servo"]

[[experiment]]
name = "prbs"
file = "motion.csv"
use = "frequency"
joint = 1
control = ["open", "open"]
prbs = { order = 10, clock = 0.001, periods = 4, amplitude = 10.0 }
"""


def columns(samples: int = 40) -> dict[str, FloatArray]:
    """Channels of a short synthetic log."""
    t = 0.001 * np.arange(samples)
    return {
        "t": t,
        "u1": np.sin(9.0 * t),
        "u2": np.cos(7.0 * t),
        "theta_m1": 10.0 * t,
        "theta_m2": -5.0 * t,
        "a1": np.cos(30.0 * t),
    }


def csv_text(values: dict[str, FloatArray], delimiter: str = ",") -> str:
    lines = [delimiter.join(values)]
    lines += [delimiter.join(f"{v:.9g}" for v in row) for row in zip(*values.values(), strict=True)]
    return "\n".join(lines) + "\n"


def write(folder: Path, study: str = STUDY, log: str | bytes | None = None) -> Path:
    """Write a study file and its log; return the study file."""
    path = folder / "study.toml"
    path.write_text(study, encoding="utf-8")
    data = csv_text(columns()) if log is None else log
    (folder / "motion.csv").write_bytes(data.encode() if isinstance(data, str) else data)
    return path
