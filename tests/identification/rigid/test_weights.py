"""The weight of a vertical axis, which is as constant as an offset of its friction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from strainwave.domain import FloatArray

MOTOR, MASS, RATIO, VISCOUS, COULOMB = 1.7e-5, 1.5, 0.003, 3e-5, 0.012
STUDY = f"""
[arm]
kind = "serial"
gravity = [0.0, 0.0, -9.81]
[[joint]]
motion = "prismatic"
spring = "rigid"
gear_ratio = {RATIO}
axis = [0.0, 0.0, 1.0]
[[experiment]]
name = "m"
file = "m.csv"
use = "motion"
control = ["open"]
"""


def log(offset: float) -> dict[str, FloatArray]:
    """Motor torque of a multisine, by (5): the axis moves in both directions."""
    time, noise = np.arange(0.0, 20.0, 1e-3), np.random.default_rng(2)
    angle, velocity, acceleration = np.zeros((3, len(time)))
    for hz, size in ((0.4, 12.0), (1.1, 3.0), (2.3, 1.0)):
        w = 2.0 * np.pi * hz
        angle += size * np.sin(w * time)
        velocity += size * w * np.cos(w * time)
        acceleration -= size * w**2 * np.sin(w * time)
    torque = (MOTOR + RATIO**2 * MASS) * acceleration + RATIO * 9.81 * MASS + offset
    torque += VISCOUS * velocity + COULOMB * np.sign(velocity)
    return {"t": time, "theta_m1": angle, "torque1": torque + noise.normal(0.0, 2e-4, len(time))}


@pytest.mark.parametrize("offset", [0.0, COULOMB])
def test_a_weight_is_identified_up_to_the_coulomb_friction(tmp_path: Path, offset: float) -> None:
    """Without the assumption nothing of mass, offset and rotor is separate."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    result = sw.identify(sw.read_study(path), data={"m": log(offset)}, stages=("rigid",))
    mass, rotor = result["link_mass", 1], result["motor_inertia", 1]
    assert mass.std == pytest.approx(COULOMB / (RATIO * 9.81), rel=0.02)
    for parameter, truth in ((mass, MASS), (rotor, MOTOR)):
        assert parameter.ci95 is not None
        assert parameter.ci95[0] < truth < parameter.ci95[1]
    assert mass.value == pytest.approx(MASS + offset / (RATIO * 9.81), rel=0.01)
    assert "assumed" in [warning.code for warning in result.warnings]
