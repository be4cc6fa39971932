"""Measured elastic joint: the results with and without its torsion sensor agree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from benchmarks.studies.measured import IST, whole_arm_parameter, with_and_without_torsion

from strainwave.domain import Identification


@pytest.fixture(scope="module")
def both(shared_data: Path) -> tuple[Identification, ...]:
    """Results from all channels, and from the motor channels alone."""
    return tuple(with_and_without_torsion(shared_data / "real" / "ist-flexible-arm"))


def test_the_motor_encoder_alone_gives_the_friction_of_both_sensors(
    both: tuple[Identification, ...],
) -> None:
    compare(both, IST)


def test_the_motor_encoder_alone_gives_the_estimates_of_both_sensors(
    both: tuple[Identification, ...],
) -> None:
    compare(both, ("motor_inertia", "link_inertia", "gear_stiffness"))
    stiffness = whole_arm_parameter(both[1], "gear_stiffness")
    assert stiffness.value is not None
    assert stiffness.std is not None
    assert stiffness.std < 0.15 * stiffness.value


def compare(both: tuple[Identification, ...], names: Sequence[str]) -> None:
    """Check that the two results agree within three standard deviations."""
    for name in names:
        full, alone = (whole_arm_parameter(result, name) for result in both)
        if alone.value is None or full.value is None:
            continue
        assert alone.std is not None
        assert full.std is not None
        difference = abs(alone.value - full.value) / np.hypot(alone.std, full.std)
        assert difference < 3.0, name


def test_its_anti_resonance_is_where_the_dip_was_measured(
    both: tuple[Identification, ...],
) -> None:
    """Published value 3.4 to 3.5 Hz, with and without the sensor."""
    for result in both:
        (response,) = result.motor_responses
        assert response.condition == "alone"
        assert response.anti_resonances_hz[0] == pytest.approx(3.45, abs=0.12)
