"""Readings of accelerometers and gyros at any place on a link, as weighted sums of link signals.

At r in the frame of its link, along the direction c, an accelerometer reads

    c . (f + dw x r + w x (w x r)) + bias

and a gyro c . w + bias. f is the specific force at the frame's origin, w and dw are the rate and
the angular acceleration of the link in space. The origin is on the link's own axis, x points along
the link and z along the axis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.quantities import Quantity

ACCELEROMETER_QUANTITIES: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration_z",
    "rate_product_zz",
)
"""Signals of a link that moves in the plane of its x and y axes: f_x, f_y, dw_z, w_z^2."""

GYRO_QUANTITIES: tuple[Quantity, ...] = ("angular_rate_z",)
"""The same for gyros: w_z."""

_IN_PLANE = [0, 1, 5, 8]  # places of these signals among all of a link


def accelerometer_weights(direction: Sequence[float], position: Sequence[float]) -> FloatArray:
    """Weights (n_quantities,) of `ACCELEROMETER_QUANTITIES` in the reading of an accelerometer."""
    return spatial_weights(direction, position)[_IN_PLANE]


def spatial_weights(direction: Sequence[float], position: Sequence[float]) -> FloatArray:
    """Weights (12,) of all signals of a link in the reading of an accelerometer.

    These are those of f, of dw, of w_x^2, w_y^2, w_z^2 and of w_x w_y, w_x w_z, w_y w_z.
    """
    (a, b, c), (x, y, z) = direction, position
    along = a * x + b * y + c * z
    turning = (y * c - z * b, z * a - x * c, x * b - y * a)
    squares = (a * x - along, b * y - along, c * z - along)
    products = (a * y + b * x, a * z + c * x, b * z + c * y)
    return np.array([a, b, c, *turning, *squares, *products])
