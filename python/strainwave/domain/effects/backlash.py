"""The spring feels the torsion beyond +-b_G alone: a dead band, (S18)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.1  # of the torsion under the largest torque


class Backlash(Effect):
    """The gear turns freely for a little."""

    name = "backlash"
    sizes = ("backlash",)
    needs_elastic_gear = True
    description = "a dead band of the gear"
    consequence = "the stiffness at small torques is too low"
    experiment = "hold the link and turn the motor to and fro through zero torque"
    record = "a record of small motion through zero torque"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest torsion."""
        return {"backlash": _SHARE * joint.largest_torque / joint.stiffness}
