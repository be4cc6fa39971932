"""Signs of torques beside springs and gravity, on a joint whose torque is given in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from strainwave.pipeline.inputs import check_input

TIME = np.arange(0.0, 20.0, 1e-3)


def codes_of(folder: Path, *, stiffness: float, hanging: float, sign: float) -> list[str]:
    """Codes of suspected faults; `hanging` is the gravity torque of a zero that hangs down."""
    rng = np.random.default_rng(1)
    w = 2.0 * np.pi * 0.15 * np.arange(1, 8)
    phase, size = rng.uniform(0.0, 2.0 * np.pi, len(w)), 0.4 / np.arange(1, 8)
    q = np.sin(np.outer(TIME, w) + phase) @ size
    dq = np.cos(np.outer(TIME, w) + phase) @ (size * w)
    ddq = -np.sin(np.outer(TIME, w) + phase) @ (size * w**2)
    torque = 0.02 * ddq + 0.05 * dq + 0.1 * np.sign(dq) + stiffness * q + hanging * np.sin(q)
    log = {"t": TIME, "theta_m1": q, "torque1": sign * torque + rng.normal(0.0, 0.005, len(q))}
    path = folder / "study.toml"
    path.write_text(
        '[arm]\nkind = "single-joint"\n'
        + ("gravity = 9.81\n" if hanging else "")
        + '[[joint]]\nspring = "rigid"\ngear_ratio = 1.0\n'
        + '[[experiment]]\nname = "m"\nfile = "m.csv"\nuse = "motion"\ncontrol = ["open"]\n'
    )
    suspected = check_input(sw.read_study(path), data={"m": log}).suspected
    return [each.code for each in suspected if not each.accepted]  # the fit estimates zeros


@pytest.mark.parametrize(("stiffness", "hanging"), [(0.0, 0.0), (0.5, 0.0), (0.0, 2.0)])
def test_a_torque_against_the_acceleration_is_no_wrong_sign(
    tmp_path: Path, stiffness: float, hanging: float
) -> None:
    assert codes_of(tmp_path, stiffness=stiffness, hanging=hanging, sign=1.0) == []


@pytest.mark.parametrize("stiffness", [0.0, 0.02])
def test_a_reversed_torque_is_reported(tmp_path: Path, stiffness: float) -> None:
    codes = codes_of(tmp_path, stiffness=stiffness, hanging=0.0, sign=-1.0)
    assert codes == ["wrong-sign"]
