"""u (1 - s_u |u|): a torque constant that falls with the current, (S22)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 0.005  # [1/V]: 5 % at 10 V


class DriveSaturation(Effect):
    """The motor's iron saturates."""

    name = "drive-saturation"
    sizes = ("drive_saturation",)
    misleads_inertias = True
    description = "a torque constant that falls with the current"
    consequence = "inertia and friction depend on how large the voltage was"
    experiment = "repeat an excitation at a third of its amplitude"
    record = "records at several amplitudes of the voltage"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Some percent at the voltage of a common drive."""
        return {"drive_saturation": _TYPICAL}
