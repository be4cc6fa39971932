"""Sizes that the keys of a study file may have.

The limits are wide: they detect a wrong unit or an inverted ratio, not an unusual machine.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SizeLimit:
    """The range of one key, and the unit in which a value outside it was probably given."""

    key: str
    minimum: float
    maximum: float
    unit: str
    other_scale: float | None = None  # from the other unit to `unit`
    other_unit: str = ""


JOINT_LIMITS = (
    SizeLimit("gear_ratio", 1e-4, 1.0, "link turns per motor turn"),
    SizeLimit("torque_per_volt", 1e-6, 1e4, "N m/V, motor side", 1e-3, "mN m/V"),
    SizeLimit("current_loop_hz", 5.0, 1e6, "Hz", 1e3, "kHz"),
    SizeLimit("encoder_counts", 4.0, 1e9, "counts per motor turn"),
    SizeLimit("link_encoder_counts", 4.0, 1e10, "counts per link turn"),
    SizeLimit("accelerometer_distance", 1e-3, 10.0, "m", 1e-3, "mm"),
    SizeLimit("accelerometer_hz", 1.0, 1e6, "Hz", 1e3, "kHz"),
    SizeLimit("gyro_hz", 0.05, 1e6, "Hz", 1e3, "kHz"),
)
IMU_LIMITS = JOINT_LIMITS[-2:]
ARM_LIMITS = (
    SizeLimit("link_length", 5e-3, 10.0, "m", 1e-3, "mm"),
    SizeLimit("gravity", 0.0, 30.0, "m/s^2", 1e-3, "mm/s^2"),
)
SERVO_LIMITS = (
    SizeLimit("period", 1e-6, 0.2, "s", 1e-3, "ms"),
    SizeLimit("limit", 1e-3, 1e4, "V", 1e-3, "mV"),
)
PRBS_LIMITS = (
    SizeLimit("clock", 1e-6, 5.0, "s", 1e-3, "ms"),
    SizeLimit("order", 2.0, 24.0, "bits"),
)
PAYLOAD_LIMITS = (
    SizeLimit("mass", 1e-3, 1e4, "kg", 1e-3, "g"),
    SizeLimit("xyz", 0.0, 10.0, "m", 1e-3, "mm"),
)


def accepted_range(key: str) -> tuple[float, float]:
    """Smallest and largest value of a key of [arm] or [[joint]]."""
    limit = next(limit for limit in (*JOINT_LIMITS, *ARM_LIMITS) if limit.key == key)
    return limit.minimum, limit.maximum
