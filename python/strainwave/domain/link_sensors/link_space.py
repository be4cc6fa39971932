"""Space in which a link moves, which limits what readings show of a sensor's mounting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.link_sensors.link_signals import OUT_OF_PLANE
from strainwave.domain.link_sensors.rotations import attitude, axes_about
from strainwave.domain.quantities import Quantity

if TYPE_CHECKING:
    from strainwave.domain.arm import ArmDescription

_MIN_SINE = 1e-9  # of the angle between two directions that are not parallel


@dataclass(frozen=True)
class LinkSpace:
    """Rotations and specific force of a link. The defaults are those of the xy plane."""

    axis: tuple[float, float, float] | None = (0.0, 0.0, 1.0)
    """Direction of all rotations in the link's frame; None: there are several."""

    is_axis_fixed: bool = False  # the link turns about an axis that does not move
    has_varying_force: bool = True  # at the origin of the link's frame
    is_flat: bool = True  # the simulation has only the signals of the xy plane

    @cached_property
    def directions(self) -> FloatArray:
        """Two directions across the axis and the axis in rows; those of the frame without axis."""
        return np.eye(3) if self.axis is None else axes_about(self.axis)

    @property
    def free_coordinates(self) -> tuple[int, ...]:
        """Coordinates of a position on the link, from 0, that change readings independently.

        A shift along the only axis changes no reading. The coordinate along which it is largest
        counts as zero.
        """
        dropped = None if self.axis is None else int(np.argmax(np.abs(self.axis)))
        return tuple(k for k in range(3) if k != dropped)

    def coordinates(self, position: FloatArray) -> list[float]:
        """The free coordinates of a position (3,) on the link."""
        if self.axis is not None:
            dropped = int(np.argmax(np.abs(self.axis)))
            position = position - position[dropped] / self.axis[dropped] * np.array(self.axis)
        return [float(position[k]) for k in self.free_coordinates]

    def has(self, quantity: Quantity) -> bool:
        """Whether the simulation has a quantity."""
        return not self.is_flat or quantity not in OUT_OF_PLANE


PLANE = LinkSpace()


def link_space(arm: ArmDescription, number: int) -> LinkSpace:
    """Space of the link of a joint, from 1."""
    attitude_in_base, axes = np.eye(3), []
    for joint in arm.joints[:number]:
        attitude_in_base = attitude_in_base @ attitude(joint.origin.rpy)
        if joint.motion == "revolute":
            axes.append(attitude_in_base @ joint.axis / np.linalg.norm(joint.axis))
    is_one_axis = bool(axes) and all(_are_parallel(axes[-1], axis) for axis in axes[:-1])
    axis = attitude_in_base.T @ axes[-1] if is_one_axis else None
    is_axis_fixed = number == 1 and is_one_axis
    return LinkSpace(
        axis=None if axis is None else (float(axis[0]), float(axis[1]), float(axis[2])),
        is_axis_fixed=is_axis_fixed,
        has_varying_force=not is_axis_fixed
        or (arm.gravity is not None and not _are_parallel(axes[0], np.array(arm.gravity))),
        is_flat=arm.has_planar_program,
    )


def _are_parallel(a: FloatArray, b: FloatArray) -> bool:
    """Whether two vectors have the same or the opposite direction, or one is zero."""
    limit = _MIN_SINE * np.linalg.norm(a) * np.linalg.norm(b)
    return bool(np.linalg.norm(np.cross(a, b)) <= limit)
