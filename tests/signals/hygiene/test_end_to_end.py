"""Identification from logs with many defects gives the same parameters as from clean logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Log
from strainwave.io.logs import read_logs
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.pipeline import identify

FOLDER = Path(__file__).parents[2] / "data" / "small-arm"
NEAR = 0.002
"""Maximum relative error of inertias and stiffness, as for clean logs of this arm."""
KINDS = ("alpha", "beta", "gamma", "motor_inertia", "link_inertia", "gear_stiffness")


def spoilt(log: Log, seed: int) -> Log:
    """Add spikes to an angle and an accelerometer, and lost counts to the other encoder."""
    rng, channels = np.random.default_rng(seed), dict(log.channels)
    for name in ("theta_m1", "a2"):
        x = channels[name].copy()
        samples = rng.integers(300, len(x) - 300, 6)
        x[samples] += 40.0 * np.abs(np.diff(x)).max()
        channels[name] = x
    stepped_angle = channels["theta_m2"].copy()
    stepped_angle[len(stepped_angle) // 2 :] += 300.0 * 2.0 * np.pi / 4096.0
    return replace(log, channels={**channels, "theta_m2": stepped_angle})


def test_defects_are_reported_and_do_not_change_the_estimates() -> None:
    study = read_study(FOLDER / "study.toml")
    logs = [spoilt(log, k) for k, log in enumerate(read_logs(study))]
    data = {log.name: {"t": log.time, **log.channels} for log in logs}
    result = identify(replace(study, channels={}), data=data)
    assert result.verdict.status == "determined"
    warnings = {(w.code, w.where) for w in result.warnings}
    for log in logs:
        assert {("spikes", f"{log.name}, theta_m1"), ("spikes", f"{log.name}, a2")} <= warnings
    true_values = read_parameters(FOLDER / "truth.json")
    compared = [
        (p.value, true_values[p.name, p.joint])
        for p in result.parameters
        if (p.name, p.joint) in true_values and p.name.startswith(KINDS)
    ]
    assert len(compared) > 12
    for value, true_value in compared:
        assert value is not None
        assert abs(value / true_value - 1.0) < NEAR
