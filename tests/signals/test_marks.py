"""Marks of a record: saturation, standstill, defects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from signal_logs import log_with, motors
from strainwave.dynamics.arm import Arm
from strainwave.signals.marks import marks_of
from strainwave.virtual import scara


def test_saturation_standstill_and_a_spike_are_marked(tmp_path: Path) -> None:
    arm = Arm.of(scara.STIFF.study(tmp_path).arm)
    channels = motors(8000) | {"a1": np.random.default_rng(3).normal(size=8000) * 0.01}
    channels["u1"] = np.clip(channels["u1"] * 4.0, -10.0, 10.0)
    channels["theta_m2"][2000:3000] = channels["theta_m2"][2000]
    channels["a1"][5000] = 40.0
    kinds = {(mark.kind, mark.channel): mark for mark in marks_of(log_with(channels), arm)}
    assert ("saturation", "u1") in kinds
    assert kinds["spikes", "a1"].start == pytest.approx(5.0)
    standing = kinds["standstill", "theta_m2"]
    assert standing.start < 2.5 < standing.stop
