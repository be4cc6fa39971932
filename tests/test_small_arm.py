"""The whole of `identify` on an arm that another engine moves: tests/data/small-arm.

Nothing of these logs comes from strainwave's own simulator but the excitation and the noise, and the
arm is unlike the built-in one: lighter links, gears of other sizes and ratios, a coarsened encoder.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import Identification, Parameter
from strainwave.io.parameters import read_parameters
from strainwave.io.results import to_document
from strainwave.pipeline import identify

FOLDER = Path(__file__).parent / "data" / "small-arm"
LIMITS = {
    "alpha": 0.002,
    "beta": 0.002,
    "gamma": 0.002,
    "motor_inertia": 0.002,
    "link_inertia": 0.002,
    "gear_stiffness_k": 0.002,
    "gear_knee_t": 0.005,
    "gear_damping": 0.006,
    "motor_coulomb_friction": 0.003,
    "total_viscous_friction": 0.02,
}
"""Largest relative errors, by how a name begins: what is asked for of arms that MuJoCo moves."""
STEP = 5e-5  # [s] of the engine, in one or two of which its friction stops a motor


@cache
def identified() -> Identification:
    return identify(FOLDER / "study.toml")


def estimates() -> list[tuple[Parameter, float]]:
    """What has a value, and its truth."""
    truth = read_parameters(FOLDER / "truth.json")
    for joint in (1, 2):
        truth["friction_settling_time", joint] = STEP
    return [
        (p, truth[p.name, p.joint]) for p in identified().parameters if (p.name, p.joint) in truth
    ]


@pytest.mark.parametrize("prefix", LIMITS)
def test_every_value_is_as_near_the_truth_as_is_asked_for(prefix: str) -> None:
    errors = {
        (p.name, p.joint): np.inf if p.value is None else p.value / true - 1.0
        for p, true in estimates()
        if p.name.startswith(prefix)
    }
    assert errors, f"nothing is called {prefix}"
    assert max(map(abs, errors.values())) < LIMITS[prefix], errors


def test_intervals_hold_the_truth() -> None:
    """Of 95 % intervals, those of one arm hold together or miss together: 85 % are asked for."""
    inside = {
        (p.name, p.joint): p.ci95 is not None and p.ci95[0] <= true <= p.ci95[1]
        for p, true in estimates()
    }
    assert len(inside) >= 30
    assert np.mean(list(inside.values())) >= 0.85, [key for key, hit in inside.items() if not hit]


def test_the_run_converges_and_answers_the_whole_question() -> None:
    found = identified()
    assert found.tuned is not None
    assert found.tuned.status == "converged"
    assert to_document(found)["status"] == "determined"


def test_it_takes_no_more_evaluations_than_it_did() -> None:
    """Of the whole arm with derivatives, model selection included: what a run's time is made of."""
    tuned = identified().tuned
    assert tuned is not None
    assert tuned.iterations <= 30


def test_steps_that_were_not_fitted_are_predicted() -> None:
    """The velocity of the joint that steps, simulated under its servo."""
    fits = {
        check["experiment"]: check["fit_percent"] for check in to_document(identified())["checks"]
    }
    for joint in (1, 2):
        assert fits[f"step-check-j{joint}"][f"omega_m{joint}"] > 99.0


def test_the_measured_response_is_the_models() -> None:
    found = identified()
    assert len(found.responses) == 2
    assert not [w for w in found.warnings if w.code == "response-apart"]


def test_the_logs_are_as_small_as_they_say() -> None:
    """A clone carries them: under a megabyte, and none of the built-in arm's parameters."""
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 1_000_000
    from strainwave.virtual import scara

    ours = scara.parameters()
    truth = json.loads((FOLDER / "truth.json").read_text())["parameters"]
    same = [
        entry["name"]
        for entry in truth
        if entry["value"] and entry["value"] == ours.get((entry["name"], entry["joint"]))
    ]
    assert not same
