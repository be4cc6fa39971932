"""A picture of a serial arm: its joints, axes and links at zero angles."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.link_sensors.link_space import attitude
from strainwave.presentation.figures import (
    SHORT_DASH,
    Axis,
    Colour,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
)

_AZIMUTH, _ELEVATION = math.radians(-60.0), math.radians(25.0)  # of the eye, about the base
_AXIS_SHARE = 0.09  # half-length of a drawn axis over the size of the arm
_ARROW_SHARE = 0.2  # length of the base's axes and of gravity over the size of the arm
_SAME_PLACE = 1e-3  # distance of joints with one label over the size of the arm
_HEIGHT = 2.0  # of the figure, in panels
_JOINT_SIZE = 9.0  # [px]


def arm_picture(arm: ArmDescription) -> Figure:
    """The arm in parallel projection, seen from the front right and above."""
    origins, axes = _frames(arm)
    size = float(np.linalg.norm(origins, axis=1).max()) or 1.0
    marks = (
        _line(np.vstack([np.zeros(3), origins]), "links", Colour.RESIDUAL, width=5.0),
        *_axis_lines(arm, origins, size * _AXIS_SHARE * axes),
        *_arrows(arm, size * _ARROW_SHARE),
        *_joint_labels(arm, origins, _SAME_PLACE * size),
    )
    panel = Panel(Axis("up in the view [m]"), marks, _HEIGHT)
    return Figure(Axis("to the right in the view [m]"), (panel,), has_equal_scales=True)


def describe(arm: ArmDescription) -> str:
    """Caption of the picture."""
    return (
        f"The {arm.n_joints} joints at zero angles, as the study"
        f"{' and its URDF place' if arm.urdf else ' places'} them. The last link has no drawn end."
    )


def _frames(arm: ArmDescription) -> tuple[FloatArray, FloatArray]:
    """Origins and unit axes of the joints in the frame of the base, (n_joints, 3) both."""
    turn, place = np.eye(3), np.zeros(3)
    origins, axes = list[FloatArray](), list[FloatArray]()
    for joint in arm.joints:
        place = place + turn @ joint.origin.xyz
        turn = turn @ attitude(joint.origin.rpy)
        origins.append(place)
        axes.append(turn @ joint.axis / np.linalg.norm(joint.axis))
    return np.array(origins), np.array(axes)


def _axis_lines(arm: ArmDescription, origins: FloatArray, axes: FloatArray) -> Iterator[Line]:
    for joint, origin, axis in zip(arm.joints, origins, axes, strict=True):
        ends = np.vstack([origin - axis, origin + axis])
        if joint.motion == "prismatic":
            yield _line(ends, "direction of prismatic joints", Colour.TUNED, SHORT_DASH)
        else:
            yield _line(ends, "axes of revolute joints", Colour.MEASURED)


def _arrows(arm: ArmDescription, length: float) -> Iterator[Mark]:
    """Axes of the base and the direction of gravity, with their names at the tips."""
    base = length * np.eye(3)
    for tip in base:
        yield _line(np.vstack([np.zeros(3), tip]), "frame of the base", Colour.LINEAR, width=1.5)
    yield _points(base, ("x", "y", "z"), "frame of the base", Colour.LINEAR)
    if arm.gravity:
        tip = length / arm.gravity_size * np.array(arm.gravity)
        yield _line(np.vstack([np.zeros(3), tip]), "gravity", Colour.MODEL, width=1.5)
        yield _points(tip[None], ("g",), "gravity", Colour.MODEL)


def _joint_labels(arm: ArmDescription, origins: FloatArray, near: float) -> Iterator[Markers]:
    """A point with the names of all joints at each place."""
    places = list[tuple[FloatArray, list[str]]]()
    for origin, name in zip(origins, arm.joint_names, strict=True):
        for place, names in places:
            if np.linalg.norm(place - origin) < near:
                names.append(name)
                break
        else:
            places.append((origin, [name]))
    labels = tuple(", ".join(names) for _, names in places)
    points = np.array([place for place, _ in places])
    yield _points(points, labels, "joints", Colour.MEASURED, _JOINT_SIZE)


def _line(
    points: FloatArray, name: str, colour: str, dash: tuple[float, ...] = (), width: float = 3.0
) -> Line:
    x, y = _projected(points)
    return Line(x, y, name, colour, dash, width)


def _points(
    points: FloatArray, labels: tuple[str, ...], name: str, colour: str, size: float = 3.0
) -> Markers:
    x, y = _projected(points)
    return Markers(x, y, name, colour, size, labels=labels)


def _projected(points: FloatArray) -> FloatArray:
    """Right and up components of points in the view, (2, n_points)."""
    (ca, sa), (ce, se) = ((math.cos(a), math.sin(a)) for a in (_AZIMUTH, _ELEVATION))
    view = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
    return np.asarray(view @ points.T)
