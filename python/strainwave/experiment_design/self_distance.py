"""Distance between the links of an arm: capsules around the lines between the joints' frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors.rotations import attitude
from strainwave.dynamics.arm import Arm

_MIN_SQUARED_LENGTH = 1e-12  # [m^2] of a segment; shorter ones are points


def smallest_distance(arm: Arm, values: Values, angle: FloatArray, limit: float) -> FloatArray:
    """Smallest distance [m] between the centre lines of two links: (...); infinite without pairs.

    `angle` (..., n_joints) are link angles. The centre line of a link, and of the base, leads from
    its joint's frame to that of the next joint; that of the last link ends at its centre of mass if
    `values` contain it. Neighbours are not compared, nor links that are never further apart than
    `limit` because the links between them are too short.
    """
    starts, ends = _centre_lines(arm, values, angle)
    rest_starts, rest_ends = _centre_lines(arm, values, np.zeros(arm.n_joints))
    lengths = np.linalg.norm(rest_ends - rest_starts, axis=-1)
    smallest = np.full(angle.shape[:-1], np.inf)
    for first, second in _compared_pairs(lengths, limit):
        distance = _segment_distance(
            starts[..., first, :], ends[..., first, :], starts[..., second, :], ends[..., second, :]
        )
        smallest = np.minimum(smallest, distance)
    return smallest


def _compared_pairs(lengths: FloatArray, limit: float) -> Iterator[tuple[int, int]]:
    """Pairs of links, 0 for the base, that can be further apart than a distance."""
    for second in range(2, len(lengths)):
        for first in range(second - 1):
            if lengths[first + 1 : second].sum() > limit:
                yield first, second


def _centre_lines(arm: Arm, values: Values, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of the centre lines of base and links: (..., n_joints + 1, 3) [m], base's frame."""
    position, axes = np.zeros((*angle.shape[:-1], 3)), np.eye(3)
    origins = [position]
    for i, joint in enumerate(arm.joints):
        position = position + axes @ np.array(joint.origin.xyz)
        axes = axes @ attitude(joint.origin.rpy)
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        if joint.motion == "prismatic":
            position = position + angle[..., i, None] * (axes @ axis)
        else:
            axes = axes @ _turned(axis, angle[..., i])
        origins.append(position)
    last = arm.n_joints
    mass = values.get(("link_mass", last), 0.0)
    moments = [values.get((f"link_first_moment_{x}", last), 0.0) for x in "xyz"]
    origins.append(position + axes @ (np.array(moments) / mass) if mass > 0.0 else position)
    points = np.stack(origins, axis=-2)
    return points[..., :-1, :], points[..., 1:, :]


def _turned(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) about a unit vector, by Rodrigues' formula."""
    x, y, z = axis.tolist()
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.asarray(np.eye(3) + sine * across + (1.0 - cosine) * (across @ across))


def _segment_distance(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> FloatArray:
    """Distance of two line segments, arrays (..., 3): (...).

    The nearest points minimise a quadratic function over the unit square (Ericson 2005, 5.1.9).
    """
    u, v, w = end - start, other_end - other_start, start - other_start
    a, b, c, d, e = (np.sum(p * q, axis=-1) for p, q in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    a, c = np.maximum(a, _MIN_SQUARED_LENGTH), np.maximum(c, _MIN_SQUARED_LENGTH)
    determinant = a * c - b * b
    is_skew = determinant > _MIN_SQUARED_LENGTH * a * c
    s = np.where(is_skew, (b * e - c * d) / np.where(is_skew, determinant, 1.0), 0.0)
    t = np.clip((b * np.clip(s, 0.0, 1.0) + e) / c, 0.0, 1.0)
    s = np.clip((b * t - d) / a, 0.0, 1.0)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.asarray(np.linalg.norm(gap, axis=-1))
