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
    "torsion",
    "encoder",
    "accelerometer",
    "gyro",
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
    "angular_rate_x",
    "angular_rate_y",
    "angular_rate_z",
    "imu_a",
    "imu_ax",
    "imu_ay",
    "imu_az",
    "imu_gx",
    "imu_gy",
    "imu_gz",
    "sliding",
]
"""Quantities that a simulation can record.

`imu_ax` and the like are readings of a kind of sensor on each link: weighted sums of signals of the
link, whose weights the simulation is given.
"""
