"""Full identification of an arm simulated by MuJoCo: tests/data/small-arm.

Only the excitation and the noise come from strainwave's simulator. The arm differs from the
built-in one: lighter links, other gear sizes and ratios, a coarser encoder.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from small_arm import FOLDER, whole
from strainwave.domain import Identification, Parameter
from strainwave.io.parameters import read_parameters
from strainwave.io.results import to_document

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
"""Largest relative error by name prefix: the requirement for arms simulated by MuJoCo."""
STEP = 5e-5  # [s] time step of the engine; its friction stops a motor within one or two steps


def identified() -> Identification:
    run = whole().run
    assert run is not None
    return run


def estimates() -> list[tuple[Parameter, float]]:
    """Return the estimated parameters with their true values."""
    truth = read_parameters(FOLDER / "truth.json")
    for joint in (1, 2):
        truth["friction_settling_time", joint] = STEP
    return [
        (p, truth[p.name, p.joint]) for p in identified().parameters if (p.name, p.joint) in truth
    ]


@pytest.mark.parametrize("prefix", LIMITS)
def test_errors_are_within_the_required_accuracy(prefix: str) -> None:
    errors = {
        (p.name, p.joint): np.inf if p.value is None else p.value / true - 1.0
        for p, true in estimates()
        if p.name.startswith(prefix)
    }
    assert errors, f"nothing is called {prefix}"
    assert max(map(abs, errors.values())) < LIMITS[prefix], errors


def test_intervals_contain_the_true_values() -> None:
    """At least 85 % of the 95 % confidence intervals contain the true value.

    The errors of one arm are correlated, so the coverage of a single arm varies.
    """
    is_covered = {
        (p.name, p.joint): p.ci95 is not None and p.ci95[0] <= true <= p.ci95[1]
        for p, true in estimates()
    }
    assert len(is_covered) >= 30
    assert np.mean(list(is_covered.values())) >= 0.85, [
        key for key, hit in is_covered.items() if not hit
    ]


def test_the_run_converges_and_is_determined() -> None:
    result = identified()
    assert result.whole_arm is not None
    assert result.whole_arm.status == "converged"
    assert to_document(result)["status"] == "determined"


def test_the_number_of_evaluations_does_not_increase() -> None:
    """Iterations of the whole-arm fit including model selection, which dominate the run time."""
    whole_arm = identified().whole_arm
    assert whole_arm is not None
    assert whole_arm.iterations <= 30


def test_steps_that_were_not_fitted_are_predicted() -> None:
    """Velocity of the stepped joint, simulated with its servo."""
    fits = {
        check["experiment"]: check["fit_percent"] for check in to_document(identified())["checks"]
    }
    for joint in (1, 2):
        assert fits[f"step-check-j{joint}"][f"omega_m{joint}"] > 99.0


def test_the_measured_response_matches_the_model() -> None:
    result = identified()
    assert len(result.responses) == 2
    assert not [w for w in result.warnings if w.code == "response-apart"]


def test_the_data_are_small_and_share_no_value_with_the_built_in_arm() -> None:
    """The data are below 1 MB and share no parameter with the built-in arm."""
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 1_000_000
    from strainwave.virtual import scara

    built_in = scara.STIFF.parameters()
    truth = json.loads((FOLDER / "truth.json").read_text())["parameters"]
    equal_names = [
        entry["name"]
        for entry in truth
        if entry["value"] and entry["value"] == built_in.get((entry["name"], entry["joint"]))
    ]
    assert not equal_names
