"""s_t sin a + c_t cos a at a link's angle in space: gravity that the model lacks, (S23)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.05  # of the largest gear torque


class Tilt(Effect):
    """The arm's base is not level, or gravity not where the study has it."""

    name = "tilt"
    sizes = ("tilt_sin", "tilt_cos")
    misleads_inertias = True
    description = "gravity that the model does not have, as of a tilted base"
    consequence = "friction and inertias of slow motion are biased"
    experiment = "put a level on the base; or hold the joint at angles half a turn apart"
    record = "a record of slow motion over the joint's whole range"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque."""
        return dict.fromkeys(self.sizes, _SHARE * joint.largest_torque)
