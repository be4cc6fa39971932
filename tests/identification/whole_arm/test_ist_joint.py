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


def test_a_flexible_joint_without_motion_records(both: tuple[Identification, ...]) -> None:
    """Measured arm: anti-resonance at 3.4 to 3.5 Hz, resonance at 4.0 to 4.5 Hz."""
    identification, _ = both
    assert identification.verdict.status == "determined"
    values = {p.key: p for p in identification.parameters}
    assert values["motor_inertia", 1].model_std is not None  # plausible effects would move it
    # a plausible ripple of less than one period does not determine the offset
    offset, friction = values["friction_offset", 1], values["motor_coulomb_friction", 1]
    assert offset.std is not None
    assert friction.value is not None
    assert offset.std < friction.value
    assert identification.rigid is None
    (record,) = identification.records
    assert record.modes is not None
    assert record.physical is identification.joints[0]  # the joint has only this record
    for modes in (record.modes, record.physical):
        assert modes.anti_resonance is not None
        assert modes.resonance is not None
        assert 3.4 < modes.anti_resonance.frequency_hz < 3.5
        assert 4.0 < modes.resonance.frequency_hz < 4.5
