"""The built-in rig has its published base parameters and anti-resonances."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from strainwave.errors import InvalidInput
from strainwave.virtual import scara


@pytest.mark.parametrize(
    ("disks", "alpha", "beta", "gamma"),
    [(0, 0.997, 0.188, 0.263), (3, 1.365, 0.462, 0.578), (5, 1.610, 0.644, 0.788)],
)
def test_base_parameters_match_the_published_values(
    disks: int, alpha: float, beta: float, gamma: float
) -> None:
    values = scara.parameters(disks)
    for name, expected in (("alpha", alpha), ("beta", beta), ("gamma", gamma)):
        assert values[name, None] == pytest.approx(expected, abs=6e-4)  # three decimals published


def test_decoupled_anti_resonances_are_between_10_and_30_hz() -> None:
    values = scara.parameters(5)
    link = values["alpha", None] + values["beta", None] + 2.0 * values["gamma", None]
    for joint, inertia, published in (
        (1, link, (10.3, 13.9)),
        (2, values["beta", None], (13.6, 16.7)),
    ):
        for slope, hz in zip(("k1", "k3"), published, strict=True):
            k = values[f"gear_stiffness_{slope}", joint]
            assert math.sqrt(k / inertia) / (2.0 * math.pi) == pytest.approx(hz, abs=0.06)


def test_experiments_cover_every_use() -> None:
    uses = [experiment.use for experiment in scara.study(Path("x")).experiments]
    assert {use: uses.count(use) for use in sorted(set(uses))} == {
        "check": 3,
        "frequency": 2,
        "motion": 1,
        "tuning": 2,
    }


def test_more_than_five_disks_are_rejected() -> None:
    with pytest.raises(InvalidInput, match="0 to 5"):
        scara.parameters(6)
