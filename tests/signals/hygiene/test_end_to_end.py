"""Logs full of defects identify the same arm as clean ones."""

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
"""Of inertias and stiffness: as much as clean logs of this arm are asked for."""
KINDS = ("alpha", "beta", "gamma", "motor_inertia", "link_inertia", "gear_stiffness")


def spoilt(log: Log, seed: int) -> Log:
    """Spikes of an angle and of an accelerometer, and counts lost by the other encoder."""
    rng, channels = np.random.default_rng(seed), dict(log.channels)
    for name in ("theta_m1", "a2"):
        x = channels[name].copy()
        at = rng.integers(300, len(x) - 300, 6)
        x[at] += 40.0 * np.abs(np.diff(x)).max()
        channels[name] = x
    lost = channels["theta_m2"].copy()
    lost[len(lost) // 2 :] += 300.0 * 2.0 * np.pi / 4096.0
    return replace(log, channels={**channels, "theta_m2": lost})


def test_defects_are_named_and_change_nothing() -> None:
    study = read_study(FOLDER / "study.toml")
    logs = [spoilt(log, k) for k, log in enumerate(read_logs(study))]
    data = {log.name: {"t": log.time, **log.channels} for log in logs}
    found = identify(replace(study, channels={}), data=data)
    assert found.verdict.status == "determined"
    named = {(w.code, w.where) for w in found.warnings}
    for log in logs:
        assert {("spikes", f"{log.name}, theta_m1"), ("spikes", f"{log.name}, a2")} <= named
    truth = read_parameters(FOLDER / "truth.json")
    compared = [
        (p.value, truth[p.name, p.joint])
        for p in found.parameters
        if (p.name, p.joint) in truth and p.name.startswith(KINDS)
    ]
    assert len(compared) > 12
    for value, true in compared:
        assert value is not None
        assert abs(value / true - 1.0) < NEAR
