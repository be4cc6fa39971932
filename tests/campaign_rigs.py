"""Studies of one rigid joint that take 1/20 s each: no effect may explain their residuals."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

STUDY = """\
[arm]
kind = "single-joint"

[[joint]]
spring = "rigid"
gear_ratio = 1.0
effects = []

[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo"]
"""


@cache
def log(inertia: float, backwards: bool = True) -> bytes:
    """Angle and torque of a joint. Without a reversal, Coulomb friction is not identifiable."""
    t = 2e-3 * np.arange(2500)
    steady = 0.0 if backwards else 60.0
    rate = steady + 40.0 * np.sin(2.0 * t) + 9.0 * np.sin(5.3 * t)
    angle = steady * t + 20.0 * (1.0 - np.cos(2.0 * t)) + 9.0 / 5.3 * (1.0 - np.cos(5.3 * t))
    acceleration = 80.0 * np.cos(2.0 * t) + 9.0 * 5.3 * np.cos(5.3 * t)
    torque = inertia * acceleration + 0.01 * rate + 0.3 * np.sign(rate)
    rows = [f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(t, angle, torque, strict=True)]
    return "\n".join(["t,theta_m1,torque1", *rows, ""]).encode()


def inertia_of(number: int) -> float:
    """True inertia of a rig [kg m^2]."""
    return 0.02 + 0.001 * (number % 7)


def rig(folder: Path, number: int = 0) -> Path:
    """A study with the status determined."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.toml").write_text(STUDY)
    (folder / "motion.csv").write_bytes(log(inertia_of(number)))
    return folder / "study.toml"


def rigs(folder: Path, count: int) -> Path:
    """A folder of studies."""
    for number in range(count):
        rig(folder / f"rig-{number:03d}", number)
    return folder
