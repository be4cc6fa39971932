"""Visits of a serial arm that changes its payload: simulate, campaign, compare and trend."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from command_line import run_here

_JOINT = """
[[joint]]
origin = {{ xyz = [{x}, 0.0, 0.2], rpy = [-1.5707963267948966, 0.0, 0.2] }}
spring = "rigid"
gear_ratio = 0.01
torque_per_volt = 0.08
encoder_counts = 8192
"""
_STUDY = (
    '[arm]\nkind = "serial"\ngravity = [0.0, 0.0, -9.81]\n'
    + _JOINT.format(x=0.0)
    + _JOINT.format(x=0.3)
    + """
[servo]
kind = "pi-velocity"
period = 0.001
kp = [0.1, 0.08]
ki = [1.0, 0.8]
limit = 10.0
position_gain = [5.0, 5.0]

[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo", "servo"]
"""
)
_LINK = {"Ixx": 0.06, "Iyy": 0.24, "Izz": 0.22, "Ixy": 0.01, "Ixz": -0.008, "Iyz": 0.004}
_FRICTION = {"motor_viscous_friction": 2e-4, "motor_coulomb_friction": 0.03}
_PAYLOAD = 0.2  # [kg] on the axis x of link 2, from the fourth visit
_LEVER = 0.4  # [m]
_VISITS = 5


def _parameters(payload: float) -> str:
    """A result with the standard parameters of the arm, whose last link carries a payload."""
    links = {f"{name}{i}": value for i in (1, 2) for name, value in _LINK.items()}
    links |= {"m1": 4.0, "mx1": 0.1, "my1": 0.04, "mz1": 0.03}
    links |= {"m2": 3.0 + payload, "mx2": 0.5 + payload * _LEVER, "my2": 0.04, "mz2": 0.03}
    for name in ("Iyy2", "Izz2"):
        links[name] += payload * _LEVER**2
    links |= {"motor_inertia1": 1e-4, "motor_inertia2": 1e-4}
    friction = [
        {"name": name, "joint": i, "value": value}
        for i in (1, 2)
        for name, value in _FRICTION.items()
    ]
    return json.dumps({"parameters": friction, "standard_parameters": links})


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("visits")
    (folder / "plan.toml").write_text(_STUDY)
    for visit in range(_VISITS):
        (folder / "p.json").write_text(_parameters(_PAYLOAD if visit > 2 else 0.0))
        out = folder / "robot" / f"2026-0{visit + 1}-05"
        seed = ("--seed", str(visit), "-q")
        command = ("simulate", folder / "plan.toml", "--parameters", folder / "p.json")
        assert run_here(*command, "--out", out, *seed).returncode == 0
    done = run_here("campaign", folder / "robot", "--out", folder / "store", "--stages", "rigid")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "store"


def test_a_payload_is_a_step_of_the_base_parameters(store: Path) -> None:
    arm = "(?P<arm>robot)/(?P<time>[0-9-]+)/"
    done = run_here("trend", store, "--arm", arm, "--out", store.parent / "trend")
    assert done.returncode == 4, done.stderr
    assert "link_first_moment_x 2" in done.stdout
    assert "step at 2026-04-05" in done.stdout
    assert "friction" not in done.stdout


def test_results_with_two_payloads_differ_by_the_payload(store: Path) -> None:
    runs = {row["study"]: row["result"] for row in sw.read_runs(store).to_pylist()}
    first, *_, last = (store / runs[name] for name in sorted(runs))
    done = run_here("compare", first, last, "--out", store.parent / "compared")
    assert done.returncode == 4, done.stderr
    moments = [
        value
        for result in (first, last)
        if (value := sw.read_result(result)["link_first_moment_x", 2].value) is not None
    ]
    # the residual of a simulated arm is small, but not zero
    errors = sw.read_result(last).document["stages"]["rigid"]["torque_errors"]
    assert [entry["joint"] for entry in errors] == [1, 2]
    assert all(0.0 < entry["value"] < 0.01 for entry in errors)
    assert np.diff(moments) == pytest.approx([_PAYLOAD * _LEVER], rel=0.02)
    verdict = done.stdout[done.stdout.index("verdict:") :]
    assert "link_first_moment_x 2" in verdict
    assert "friction" not in verdict
