"""Readings of accelerometers and gyros at any place on a link, as weighted sums of link signals.

At r in the frame of its link, along the direction c, an accelerometer reads

    c . (f + dw x r + w x (w x r)) + bias

and a gyro c . w + bias. f is the specific force at the frame's origin, w and dw are the rate and
the angular acceleration of the link in space. The origin is on the link's own axis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.quantities import Quantity

ACCELEROMETER_QUANTITIES: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "specific_force_z",
    "angular_acceleration_x",
    "angular_acceleration_y",
    "angular_acceleration_z",
    "rate_product_xx",
    "rate_product_yy",
    "rate_product_zz",
    "rate_product_xy",
    "rate_product_xz",
    "rate_product_yz",
)
"""Signals of a link: f, dw and the products of w."""

GYRO_QUANTITIES: tuple[Quantity, ...] = ("angular_rate_x", "angular_rate_y", "angular_rate_z")
"""The same for gyros: w."""

LINK_SIGNALS = (*ACCELEROMETER_QUANTITIES, *GYRO_QUANTITIES)
"""All signals of a link, in the order of the compiled core."""

_IN_PLANE: tuple[Quantity, ...] = (
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration_z",
    "rate_product_zz",
    "angular_rate_z",
)
OUT_OF_PLANE = frozenset(LINK_SIGNALS).difference(_IN_PLANE)
"""Signals that are zero on a link that moves in the xy plane."""


def accelerometer_weights(direction: Sequence[float], position: Sequence[float]) -> FloatArray:
    """Weights (12,) of `ACCELEROMETER_QUANTITIES` in the reading of an accelerometer."""
    (a, b, c), (x, y, z) = direction, position
    along = a * x + b * y + c * z
    turning = (y * c - z * b, z * a - x * c, x * b - y * a)
    squares = (a * x - along, b * y - along, c * z - along)
    products = (a * y + b * x, a * z + c * x, b * z + c * y)
    return np.array([a, b, c, *turning, *squares, *products])
