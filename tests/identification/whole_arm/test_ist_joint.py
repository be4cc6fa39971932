"""Measured elastic joint: the results with and without its torsion sensor agree.

`pytest tests/identification/whole_arm/test_ist_joint.py -s` prints the table of docs/benchmarks.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import Identification, Parameter
from strainwave.pipeline import identify

PRIMARY = (
    "motor_inertia",
    "link_inertia",
    "gear_stiffness",
    "gear_damping",
    "motor_coulomb_friction",
    "total_viscous_friction",
)


@pytest.fixture(scope="module")
def both(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Identification, Identification]:
    """Results from all channels, and from the motor channels alone."""
    measured = shared_data / "real" / "ist-flexible-arm"
    folder = tmp_path_factory.mktemp("ist")
    for name in ("PRBS.csv", "square.csv"):
        (folder / name).symlink_to(measured / name)
    lines = (measured / "study.toml").read_text().splitlines()
    motor_lines = [line for line in lines if not line.startswith("deflection1")]
    (folder / "study.toml").write_text("\n".join(motor_lines) + "\n")
    return identify(measured / "study.toml"), identify(folder / "study.toml")


def _whole_arm(found: Identification, name: str) -> Parameter:
    assert found.whole_arm is not None
    return next(p for p in found.whole_arm.parameters if p.name == name)


def test_the_motor_encoder_alone_gives_the_estimates_of_both_sensors(
    both: tuple[Identification, Identification],
) -> None:
    for name in PRIMARY:
        full, alone = (_whole_arm(result, name) for result in both)
        print(f"| {name} | {_cell(full)} | {_cell(alone)} |")
        if alone.value is None or full.value is None:
            continue
        assert alone.std is not None
        assert full.std is not None
        difference = abs(alone.value - full.value) / np.hypot(alone.std, full.std)
        assert difference < 3.0, name
    stiffness = _whole_arm(both[1], "gear_stiffness")
    assert stiffness.value is not None
    assert stiffness.std is not None
    assert stiffness.std < 0.15 * stiffness.value


def test_its_anti_resonance_is_where_the_dip_was_measured(
    both: tuple[Identification, Identification],
) -> None:
    """Published value 3.4 to 3.5 Hz, with and without the sensor."""
    for result in both:
        (response,) = result.motor_responses
        assert response.condition == "alone"
        assert response.anti_resonances_hz[0] == pytest.approx(3.45, abs=0.12)


def _cell(parameter: Parameter) -> str:
    if parameter.value is None or parameter.std is None:
        return "not identified"
    return f"{parameter.value:.4g} ± {parameter.std:.2g} {parameter.unit}"
