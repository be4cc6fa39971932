"""Backlash, (S18): the spring acts only on the torsion beyond +-b_G."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_TORSION_SHARE = 0.1  # of the torsion at the largest gear torque


class Backlash(Effect):
    """Dead band of the gear."""

    name = "backlash"
    sizes = ("backlash",)
    needs_elastic_gear = True
    description = "a dead band of the gear"
    consequence = "the estimated stiffness at small torques is too low"
    experiment = "hold the link and turn the motor back and forth through zero torque"
    record = "a record of small motion through zero torque"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest torsion."""
        return {"backlash": _TYPICAL_TORSION_SHARE * joint.largest_torque / joint.stiffness}
