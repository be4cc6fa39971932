"""u (1 + g_u): a drive whose torque per volt is not the study's, (S21)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 0.05


class DriveGain(Effect):
    """The torque per volt of one joint is off."""

    name = "drive-gain"
    sizes = ("drive_gain",)
    misleads_inertias = True
    description = "an error of the torque per volt"
    consequence = (
        "every torque of the joint, and with it inertia, friction and stiffness, is scaled"
    )
    experiment = (
        "measure the motor's torque, or its current and torque constant, at a known voltage"
    )
    record = "records in which this joint and another accelerate each other"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Some percent, the same of every drive."""
        return {"drive_gain": _TYPICAL}
