"""The factor that all torque-like parameters share."""

from __future__ import annotations

import numpy as np
import pytest

from compared_results import covariance, drawn, estimates
from strainwave.fleet.monitoring.comparison import compare
from strainwave.fleet.monitoring.significance import common_factor, is_torque_like

NAMES = ("beta", "gear_stiffness 1", "motor_inertia 1", "motor_viscous_friction 1")


def draws(
    rng: np.random.Generator, factors: list[float]
) -> list[tuple[float, float, float, float]]:
    true = rng.uniform(1.0, 5.0, len(factors))
    std = 0.01 * true
    errors = rng.normal(size=(2, len(factors))) * std
    first, second = (true + errors[0]).tolist(), (factors * true + errors[1]).tolist()
    return list(zip(first, std.tolist(), second, std.tolist(), strict=True))


def test_the_factor_is_estimated_with_its_standard_deviation() -> None:
    rng = np.random.default_rng(3)
    scores = []
    for _ in range(200):
        factor = common_factor(draws(rng, [1.2] * 8), 0.05)
        if factor is not None:
            scores.append((factor.value - 1.2) / factor.std)
    assert len(scores) > 190  # the misfit test refuses one in a hundred
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("factors", [[1.0] * 8, [1.2] * 7 + [1.0], [1.2] * 2])
def test_unchanged_values_and_different_factors_have_none(factors: list[float]) -> None:
    rng = np.random.default_rng(4)
    assert sum(common_factor(draws(rng, factors), 0.01) is not None for _ in range(100)) <= 6


def test_units_with_a_force_scale_with_the_torques() -> None:
    assert all(map(is_torque_like, ("N m", "kg m^2", "N m s/rad", "N m/rad^3", "kg", "N/m")))
    assert not any(map(is_torque_like, ("s", "rad", "1", "m", "Hz", "rad/s")))


def test_a_comparison_names_the_factor() -> None:
    rng = np.random.default_rng(5)
    S = covariance(rng)
    first = estimates(drawn(rng, S), "first")
    scaled = estimates(drawn(rng, S, dict.fromkeys(NAMES, 1.2)), "scaled")
    one_only = estimates(drawn(rng, S, {"gear_stiffness 1": 1.2}), "softer")
    comparison = compare([first, scaled, one_only])
    assert comparison.pairs[0].factor is not None
    assert comparison.pairs[0].factor.value == pytest.approx(1.2, rel=0.01)
    assert comparison.pairs[1].factor is None
    (note,) = [note for note in comparison.notes if "torque_per_volt" in note]
    assert note.startswith("scaled: all torque-like parameters differ by one factor, 1.2")
