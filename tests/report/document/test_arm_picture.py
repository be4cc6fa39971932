"""The picture of an arm: frames, axes and names of its joints in one view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exports
from strainwave.domain import ArmDescription, Joint, Origin
from strainwave.domain.arm.description import Imu
from strainwave.domain.arm.kinds import planar_two_link, single_joint
from strainwave.report.document.rig import arm_picture, describe_arm
from strainwave.report.figures import Figure, Line, Mark, Markers
from strainwave.report.plotly_backend import plotly

CHAIN = exports.chain(Path("nowhere"), motions=exports.MOTIONS[1])[0].arm


def points(mark: Mark) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Coordinates x and y in rows."""
    assert isinstance(mark, Line | Markers)
    return np.array([mark.x, mark.y], dtype=float)


def marks(figure: Figure, name: str) -> list[Line | Markers]:
    return [m for m in figure.marks if isinstance(m, Line | Markers) and m.name == name]


def test_links_join_the_joints_from_the_base() -> None:
    figure = arm_picture(CHAIN)
    (links,), (joints,) = marks(figure, "links"), marks(figure, "joints")
    assert isinstance(joints, Markers)
    assert joints.labels == ("joint1", "joint2", "joint3")
    assert (links.x[0], links.y[0]) == (0.0, 0.0)
    np.testing.assert_array_equal(links.x[1:], joints.x)
    # the first joint is 0.3 m above the base, seen from an elevation of 25 degrees
    assert joints.x[0] == pytest.approx(0.0, abs=1e-15)
    assert joints.y[0] == pytest.approx(0.3 * np.cos(np.radians(25.0)))


def test_axes_have_the_direction_of_the_joint_in_the_base() -> None:
    """The second joint turns by rpy = (pi/2, 0, 0) about x, so its z axis is -y of the base."""
    turned = Joint("rigid", 0.01, origin=Origin((0.5, 0.0, 0.0), (0.5 * np.pi, 0.0, 0.0)))
    arm = ArmDescription("serial", (Joint("rigid", 0.01), turned))
    figure = arm_picture(arm)
    _, axis = marks(figure, "axes of revolute joints")
    base_y = marks(figure, "frame of the base")[1]
    drawn, y = (np.array([np.ptp(m.x), np.ptp(m.y)]) for m in (axis, base_y))
    assert drawn / np.linalg.norm(drawn) == pytest.approx(y / np.linalg.norm(y))
    assert not marks(figure, "gravity")


def test_prismatic_joints_and_gravity_are_drawn() -> None:
    figure = arm_picture(CHAIN)
    assert len(marks(figure, "axes of revolute joints")) == 2
    assert len(marks(figure, "direction of prismatic joints")) == 1
    line, tip = marks(figure, "gravity")
    assert isinstance(tip, Markers)
    assert tip.labels == ("g",)
    assert (line.x[1], line.y[1]) == pytest.approx((tip.x[0], tip.y[0]))


def test_joints_in_one_place_share_a_label() -> None:
    """As in a spherical wrist."""
    joints = (Joint("rigid", 0.01, name="shoulder"), Joint("rigid", 0.01, origin=Origin((1, 0, 0))))
    arm = ArmDescription("serial", (*joints, Joint("rigid", 0.01)))
    (drawn,) = marks(arm_picture(arm), "joints")
    assert isinstance(drawn, Markers)
    assert drawn.labels == ("shoulder", "joint2, joint3")
    assert "The 3 joints at zero angles" in describe_arm(arm)


def test_a_planar_arm_is_seen_along_its_axes() -> None:
    """In metres of its plane, with its sensors; the last link has no stated length."""
    joints = (
        Joint("linear", 0.01, accelerometer_distance=0.3),
        Joint("linear", 0.01, imu=Imu(xyz=(0.2, 0.05, 0.0))),
    )
    figure = arm_picture(planar_two_link(joints, 0.35, 9.81))
    (links,), (drawn,) = marks(figure, "links"), marks(figure, "joints")
    np.testing.assert_allclose(points(links), [[0.0, 0.0, 0.35], [0.0, 0.0, 0.0]])
    (sensors,) = marks(figure, "sensors")
    assert isinstance(sensors, Markers)
    assert sensors.labels == ("a1", "imu2")
    np.testing.assert_allclose(points(sensors), [[0.3, 0.55], [0.0, 0.05]])
    (last,) = marks(figure, "last link, whose length is not given")
    np.testing.assert_allclose(points(last), [[0.35, 0.55], [0.0, 0.0]])
    assert (figure.x.title, figure.panels[0].axis.title) == ("x [m]", "y [m]")
    gravity, _ = marks(figure, "gravity")
    assert (gravity.x[1], gravity.y[1] < 0.0) == (0.0, True)
    assert isinstance(drawn, Markers)
    assert drawn.labels == ("joint1", "joint2")


def test_a_single_joint_has_a_picture() -> None:
    slide = single_joint(Joint("rigid", 1.0, motion="prismatic"))
    (direction,) = marks(arm_picture(slide), "direction of prismatic joints")
    assert np.ptp(direction.y) == 0.0
    assert np.ptp(direction.x) > 0.0
    assert describe_arm(slide).startswith("The joint at zero angles, as the study places it.")


@pytest.mark.parametrize("arm", [CHAIN, planar_two_link((Joint("rigid", 0.1),) * 2, 0.35)])
def test_the_axis_of_each_joint_follows_the_links(arm: ArmDescription) -> None:
    """The form marks the joint that is edited at the middle of its axis."""
    _, *axes = arm_picture(arm).marks
    centres = [points(mark).mean(axis=1) for mark in axes[: arm.n_joints]]
    (joints,) = marks(arm_picture(arm), "joints")
    np.testing.assert_allclose(np.array(centres), points(joints).T, atol=1e-12)


def test_sensors_of_a_chain_are_at_their_places() -> None:
    """Joint 2 turns by pi/2 about z, so that its link's x axis is y of the base."""
    turned = Origin((0.5, 0.0, 0.0), (0.0, 0.0, 0.5 * np.pi))
    joint = Joint("rigid", 0.01, origin=turned, accelerometer_distance=0.2)
    figure = arm_picture(ArmDescription("serial", (Joint("rigid", 0.01), joint)))
    (sensors,), (joints,) = marks(figure, "sensors"), marks(figure, "joints")
    y_tip = marks(figure, "frame of the base")[1]
    moved, along_y = points(sensors)[:, 0] - points(joints)[:, 1], points(y_tip)[:, 1]
    size = np.hypot(0.5, 0.2)  # of the arm with its sensor; axes of the base have a fifth of it
    np.testing.assert_allclose(moved / 0.2, along_y / (0.2 * size))


def test_a_gravity_of_zero_has_no_arrow() -> None:
    arm = ArmDescription("serial", (Joint("rigid", 0.01),), gravity=(0.0, 0.0, 0.0))
    assert not marks(arm_picture(arm), "gravity")


def test_both_back_ends_keep_scales_and_labels() -> None:
    figure = arm_picture(CHAIN)
    drawn = plotly(figure)
    assert drawn["layout"]["yaxis"]["scaleanchor"] == "x"
    texts = [trace["text"] for trace in drawn["data"] if "text" in trace]
    assert ["joint1", "joint2", "joint3"] in texts
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed")
    from strainwave.report.matplotlib_backend import draw

    (axes,) = draw(figure).axes
    assert axes.get_aspect() == 1.0
    assert {"joint2", "x", "g"} <= {text.get_text() for text in axes.texts}
