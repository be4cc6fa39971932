"""u less u_0 against its sign, nothing within +-u_0: a drive with a dead zone, (S20)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 0.1  # [V]


class DeadZone(Effect):
    """The drive does not answer to small commands."""

    name = "dead-zone"
    sizes = ("dead_zone",)
    misleads_inertias = True
    description = "a dead zone of the drive about zero voltage"
    consequence = "Coulomb friction is too large where the voltage follows the motion's direction"
    experiment = "measure the motor's current at small voltages of either sign"
    record = "a record whose voltage takes many levels, small ones among them"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A hundredth of the voltage of a common drive."""
        return {"dead_zone": _TYPICAL}
