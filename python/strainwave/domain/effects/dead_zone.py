"""Dead zone of the drive, (S20): u is reduced by u_0 in magnitude, and is zero within +-u_0."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_WIDTH = 0.1  # [V] 1 % of the range of a 10 V drive


class DeadZone(Effect):
    """The drive does not respond to small commands."""

    name = "dead-zone"
    sizes = ("dead_zone",)
    misleads_inertias = True
    description = "a dead zone of the drive around zero voltage"
    consequence = "Coulomb friction is too large if the voltage has the sign of the velocity"
    experiment = "measure the motor's current at small voltages of either sign"
    record = "a record with many voltage levels, including small ones"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """1 % of the voltage range of a common drive."""
        return {"dead_zone": _TYPICAL_WIDTH}
