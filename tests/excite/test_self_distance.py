"""Distances between links: frames as in Pinocchio, segments as by search, skipped pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from serial_chains import random_joints
from strainwave.domain import ArmDescription, FloatArray, Joint, Origin
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.excite.guessed_arm import (
    _centre_lines,
    _segment_distance,
    smallest_distance,
)


def arm_of(*joints: Joint) -> Arm:
    return Arm.of(ArmDescription("serial", joints, (0.0, 0.0, -9.81)))


def _joint(motion: str, xyz: list[float], rpy: list[float], axis: list[float]) -> Joint:
    return Joint(
        "rigid",
        0.01,
        "prismatic" if motion == "prismatic" else "revolute",
        origin=Origin((xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2])),
        axis=(axis[0], axis[1], axis[2]),
    )


@pytest.mark.parametrize("types", ["rpr", "rrrrrr", "prrprrr"])
def test_centre_lines_lead_from_frame_to_frame(types: str) -> None:
    pinocchio = pytest.importorskip("pinocchio", reason="the package pin is not installed")
    from dynamics.test_chain_against_pinocchio import pinocchio_model

    rng = np.random.default_rng(len(types))
    drawn = random_joints(rng, len(types), types)
    arm = arm_of(*(_joint(*each) for each in drawn))
    body = {"mass": 1.0, "centre": np.zeros(3), "inertia": np.eye(3)}
    model = pinocchio_model(drawn, [body] * len(types))
    data, angle = model.createData(), rng.uniform(-2.0, 2.0, (5, len(types)))
    last = len(types)
    values: Values = {("link_mass", last): 2.0, ("link_first_moment_y", last): 0.6}
    starts, ends = _centre_lines(arm, values, angle)
    for k, posture in enumerate(angle):
        pinocchio.forwardKinematics(model, data, posture)
        frames = [np.array(frame.translation) for frame in data.oMi]
        np.testing.assert_allclose(starts[k], frames, atol=1e-12)
        tip = data.oMi[last].act(np.array([0.0, 0.3, 0.0]))
        np.testing.assert_allclose(ends[k], [*frames[1:], tip], atol=1e-12)


points = st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12)


@given(points)
def test_the_distance_of_segments_is_the_smallest_of_their_points(numbers: list[float]) -> None:
    a, b, c, d = np.array(numbers).reshape(4, 3)
    distance = float(_segment_distance(a, b, c, d))
    share: FloatArray = np.linspace(0.0, 1.0, 81)
    one, other = a + share[:, None] * (b - a), c + share[:, None] * (d - c)
    nearest = np.linalg.norm(one[:, None] - other, axis=-1).min()
    # points of the grid are up to half a step from the nearest ones, on both segments
    step = (np.linalg.norm(b - a) + np.linalg.norm(d - c)) / 160.0
    assert nearest - step - 1e-6 <= distance <= nearest + 1e-6
    assert float(_segment_distance(c, d, b, a)) == pytest.approx(distance, abs=1e-6)


def test_links_that_are_always_near_are_not_compared() -> None:
    """Two long links with a short one between them fold to a distance of the short one."""
    lengths = (0.0, 0.5, 0.06, 0.5)
    arm = arm_of(*(Joint("rigid", 0.01, origin=Origin((length, 0.0, 0.0))) for length in lengths))
    folded = np.array([[0.0, 0.5 * np.pi, 0.5 * np.pi, 0.0], [0.0, 0.0, 0.0, 0.0]])
    values: Values = {("link_mass", 4): 1.0, ("link_first_moment_x", 4): 0.4}
    near, stretched = smallest_distance(arm, values, folded, 0.05)
    assert near == pytest.approx(0.06)
    assert stretched == pytest.approx(0.06)
    # the base and link 2 are half a metre apart
    assert smallest_distance(arm, values, folded[1:], 0.1)[0] == pytest.approx(0.5)
    assert np.isinf(smallest_distance(arm, values, folded, 2.0)).all()
