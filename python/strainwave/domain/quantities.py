"""Names of the quantities that the compiled core simulates, one value per joint each."""

from __future__ import annotations

from typing import Literal

Quantity = Literal[
    "voltage",
    "motor_torque",
    "motor_angle",
    "motor_velocity",
    "link_angle",
    "link_velocity",
    "link_acceleration",
    "gear_torque",
    "encoder",
    "accelerometer",
    "gyro",
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration",
    "squared_rate",
    "angular_rate",
    "sliding",
]
"""Quantities that a simulation can record."""
