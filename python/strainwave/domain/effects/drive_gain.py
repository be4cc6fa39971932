"""Drive gain, (S21): u (1 + g_u), an error of the study's torque per volt."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_GAIN_ERROR = 0.05  # tolerance of a motor's torque constant


class DriveGain(Effect):
    """The torque per volt of one joint is wrong."""

    name = "drive-gain"
    sizes = ("drive_gain",)
    misleads_inertias = True
    description = "an error of the torque per volt"
    consequence = "all torques of the joint, and hence inertia, friction and stiffness, are scaled"
    experiment = (
        "measure the motor's torque, or its current and torque constant, at a known voltage"
    )
    record = "records in which this joint and another accelerate each other"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every drive."""
        return {"drive_gain": _TYPICAL_GAIN_ERROR}
