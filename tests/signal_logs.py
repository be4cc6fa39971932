"""A log of given channels, and channels of two motors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import Experiment, FloatArray, Log

T = 1e-3


def log_with(channels: Mapping[str, FloatArray]) -> Log:
    samples = len(next(iter(channels.values())))
    experiment = Experiment("one", "one.csv", "motion", ("servo", "servo"))
    return Log(experiment, np.arange(samples) * np.float64(T), T, channels)


def motors(samples: int) -> dict[str, FloatArray]:
    angle = 3.0 * np.sin(2.0 * np.pi * 0.7 * T * np.arange(samples))
    return {"theta_m1": angle, "theta_m2": 0.5 * angle, "u1": 2.0 * angle, "u2": angle}
