"""A design of the built-in arm, and the same with filters that no margin required."""

from __future__ import annotations

from dataclasses import replace

import pytest

import exports
from strainwave.tune.closed_loop import low_pass, notch
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo


@pytest.fixture(scope="session")
def design(tmp_path_factory: pytest.TempPathFactory) -> ServoDesign:
    study = exports.two_links(tmp_path_factory.mktemp("design"))
    arm = exports.arm_of(study, exports.values_of(study))
    return design_servo(arm, None, ServoOptions(postures=((0.3, -0.4),), draws=5, seed=3))


@pytest.fixture(scope="session")
def filtered(design: ServoDesign) -> ServoDesign:
    """The first joint has a notch and a low-pass, the second none."""
    first, second = design.joints
    period = design.clock.period
    filters = (notch(40.0, 0.5, 0.1, period), low_pass(100.0, period))
    gains = replace(first.gains, filters=filters)
    return replace(design, joints=(replace(first, gains=gains), second))
