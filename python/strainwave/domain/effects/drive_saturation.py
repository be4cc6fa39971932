"""Drive saturation, (S22): u (1 - s_u |u|), a torque constant that falls with the current."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_LOSS_PER_VOLT = 0.005  # [1/V] 5 % at 10 V


class DriveSaturation(Effect):
    """The motor's iron saturates."""

    name = "drive-saturation"
    sizes = ("drive_saturation",)
    misleads_inertias = True
    description = "a torque constant that falls with the current"
    consequence = "inertia and friction depend on the voltage amplitude"
    experiment = "repeat an excitation at one third of its amplitude"
    record = "records at several amplitudes of the voltage"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every drive."""
        return {"drive_saturation": _TYPICAL_LOSS_PER_VOLT}
